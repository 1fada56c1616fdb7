"""Fitting of surfaces to images: virtual image, cost, solvers, stages, and how an organ is fitted by them."""
