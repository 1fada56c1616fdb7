"""Modules qt and ctk and Slicer's widgets made from a record of what a real Slicer has; anything else is refused."""
