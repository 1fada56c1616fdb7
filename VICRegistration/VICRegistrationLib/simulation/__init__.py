"""Finite element analysis of tetrahedral meshes: linear elasticity, with scikit-fem."""
