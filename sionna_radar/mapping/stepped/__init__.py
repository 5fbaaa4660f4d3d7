"""The DEM method "stepped": coarse map, segmentation at steps, plane fits, and borders between regions."""
