"""The DEM methods "smooth" and "refined": smooth surfaces fitted to ranges or to whole range profiles."""
