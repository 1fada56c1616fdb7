"""Measures of a fitted surface: deviation from a reference, and reports."""
