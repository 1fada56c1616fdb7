"""From a click to a region: edges along rays, star-shaped surfaces, limits of grey levels, growing, checks."""
