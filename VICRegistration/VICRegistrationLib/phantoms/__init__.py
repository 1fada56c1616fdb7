"""Synthetic images whose true surfaces are known."""
