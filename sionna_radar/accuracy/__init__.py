"""How far a DEM lies from the truth; the only part of the processing that knows it."""
