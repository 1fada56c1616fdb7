"""Meshes of organs, tetrahedra and triangles, by gmsh in a process of its own."""
