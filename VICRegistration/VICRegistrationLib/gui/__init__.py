"""The panel: one class for every section of it, and what they share."""
