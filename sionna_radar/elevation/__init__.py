"""Elevation files: reading, reprojecting, cutting out, and interpolating heights."""
