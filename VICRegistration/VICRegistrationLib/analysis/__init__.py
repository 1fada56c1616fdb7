"""Measures of a fitted surface: distances from a reference, comparison, gaps."""
