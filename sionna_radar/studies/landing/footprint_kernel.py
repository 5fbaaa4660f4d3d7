"""Plane, slope, roughness and clearance of many landing places on one surface, compiled."""

from typing import no_type_check

import numpy as np

from sionna_radar.foundation.compiled import compiled


@no_type_check
@compiled
def fit_places(height_m, row, column, footprint, ring, spacing_m, result):
    """Fit a plane to the cells of each footprint by least squares.

    height_m: surface, shape (row, column). row, column: middles of the places.
    footprint, ring: offsets (row, column), within the surface; those of the footprint symmetric about the middle.
    result: shape (6, place): slope (rise over run), largest distance of the footprint's cells from the plane (m), the
        highest rise of the ring above it (m; 0 for a ring below), its height in the middle, its slopes east and north.
    """
    square = 0.0
    for k in range(len(footprint)):
        square += (footprint[k, 1] * spacing_m) ** 2
    for place in range(len(row)):
        r, c = row[place], column[place]
        mean, east, north = 0.0, 0.0, 0.0
        for k in range(len(footprint)):
            z = height_m[r + footprint[k, 0], c + footprint[k, 1]]
            mean += z
            north += footprint[k, 0] * z
            east += footprint[k, 1] * z
        mean, east, north = mean / len(footprint), east * spacing_m / square, north * spacing_m / square
        rough, rise = 0.0, 0.0
        for k in range(len(footprint)):
            i, j = footprint[k, 0], footprint[k, 1]
            rough = max(rough, abs(height_m[r + i, c + j] - mean - (i * north + j * east) * spacing_m))
        for k in range(len(ring)):
            i, j = ring[k, 0], ring[k, 1]
            rise = max(rise, height_m[r + i, c + j] - mean - (i * north + j * east) * spacing_m)
        result[0, place], result[1, place], result[2, place] = np.sqrt(east**2 + north**2), rough, rise
        result[3, place], result[4, place], result[5, place] = mean, east, north
