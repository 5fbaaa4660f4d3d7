"""Paths in the frames of the antennas that they belong to, as machine code."""

from typing import no_type_check

import numpy as np

from sionna_radar.foundation.compiled import compiled
from sionna_radar.radar.lobe_kernels import voltage_at


@compiled
@no_type_check
def ahead(first, position, axes, hit, out):
    """Write the unit vectors from the antennas to hits, in the antennas' frames.

    first: where the hits of each pulse begin, and where the last one's end.
    """
    for pulse in range(len(position)):
        for n in range(first[pulse], first[pulse + 1]):
            x, y, z = hit[n, 0] - position[pulse, 0], hit[n, 1] - position[pulse, 1], hit[n, 2] - position[pulse, 2]
            distance = np.sqrt(x * x + y * y + z * z)
            for k in range(3):
                out[n, k] = (x * axes[pulse, 0, k] + y * axes[pulse, 1, k] + z * axes[pulse, 2, k]) / distance


@compiled
@no_type_check
def light(first, position, axes, hit, surface, lobe, grid, origin, seen):
    """Mark the cells of a grid under hits on surfaces inside the main lobe of a separable antenna.

    lobe: the cuts in azimuth and elevation, and the least two-way power over the peak's.
    grid: middle of its south-western cell, and the spacing, in the precision of the hits.
    origin, seen: of each cell where it was last seen from, and whether at all; both are written.
    """
    azimuth, elevation, level = lobe
    west, south, spacing = grid
    rows, columns = seen.shape
    for pulse in range(len(position)):
        px, py, pz = position[pulse, 0], position[pulse, 1], position[pulse, 2]
        for n in range(first[pulse], first[pulse + 1]):
            if surface[n] < 0:
                continue
            x, y, z = hit[n, 0] - px, hit[n, 1] - py, hit[n, 2] - pz
            distance = np.sqrt(x * x + y * y + z * z)
            ahead = (x * axes[pulse, 0, 0] + y * axes[pulse, 1, 0] + z * axes[pulse, 2, 0]) / distance
            left = (x * axes[pulse, 0, 1] + y * axes[pulse, 1, 1] + z * axes[pulse, 2, 1]) / distance
            up = (x * axes[pulse, 0, 2] + y * axes[pulse, 1, 2] + z * axes[pulse, 2, 2]) / distance
            voltage = voltage_at(azimuth, left) * voltage_at(elevation, up)
            gain = voltage * voltage * max(ahead, 0.0)
            if not gain * gain >= level:
                continue
            column, row = np.rint((hit[n, 0] - west) / spacing), np.rint((hit[n, 1] - south) / spacing)
            if 0 <= row < rows and 0 <= column < columns:
                i, j = int(row), int(column)
                seen[i, j] = True
                origin[i, j, 0], origin[i, j, 1], origin[i, j, 2] = px, py, pz
