"""Tetrahedral and surface meshes of organs by gmsh or Netgen, each in a process of its own."""
