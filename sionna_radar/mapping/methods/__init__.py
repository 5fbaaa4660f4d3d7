"""The DEM methods, one file each."""
