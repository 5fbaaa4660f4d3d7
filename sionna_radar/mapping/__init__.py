"""From echoes to points, a DEM and its error."""
