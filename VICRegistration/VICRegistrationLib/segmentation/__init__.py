"""From a click to a region: edges along rays, surfaces of least cost along rays, limits of grey levels, growing."""
