"""Fitting of surfaces to images: intensity profile, virtual image, solvers and the organ recipe."""
