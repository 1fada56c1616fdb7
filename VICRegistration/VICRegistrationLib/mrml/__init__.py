"""Nodes of a Slicer scene and objects of the library, turned into each other."""
