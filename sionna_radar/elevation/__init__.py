"""Elevation files: reading, reprojecting, cutting out, and looking heights up."""
