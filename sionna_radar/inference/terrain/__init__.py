"""Terrain as a random field: covariance, local relief, smoothing, kriging, and the uncertainty of heights."""
