"""Models of several organs and of what holds them: patches that share points, organs cut from closed surfaces."""
