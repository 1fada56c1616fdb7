"""Stand-ins for the parts of Slicer's Python that need the application; they work on the real scene of slicer-core."""
