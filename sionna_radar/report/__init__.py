"""What a survey leaves behind: figures, rasters, point clouds and numbers."""
