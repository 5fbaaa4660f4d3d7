"""What a survey records while it flies, block by block, into netCDF files."""
