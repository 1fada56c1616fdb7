"""Writing of fitted surfaces for other programs."""
