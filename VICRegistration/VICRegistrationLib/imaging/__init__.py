"""Images in RAS millimetres: reading, sampling, and the separation of an organ from its surroundings."""
