"""Models of several organs and their supporting structures: B-spline patches that share control points."""
