"""Maps that interpolate points linearly: gridding, triangulation and walls."""
