"""What every room stands on: errors, rasters, random streams, progress."""
