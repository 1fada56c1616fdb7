"""Fitting of smooth B-spline surfaces to organs in medical images by virtual image correlation."""

__version__ = "0.1.0"
