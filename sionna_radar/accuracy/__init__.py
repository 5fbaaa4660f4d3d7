"""Accuracy of a DEM against the truth; the only part of the processing that knows it."""
