"""Files of results: rasters, point clouds, tables, and the folder that holds them."""
