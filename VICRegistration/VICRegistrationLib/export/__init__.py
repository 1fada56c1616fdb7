"""Writing of fitted surfaces for other programs, and reading of their meshes."""
