"""From a click to a region: edges along rays, limits of grey levels, growing, checks."""
