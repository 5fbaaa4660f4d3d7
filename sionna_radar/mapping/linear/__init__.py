"""The DEM method "linear": triangulation, gridding and walls."""
