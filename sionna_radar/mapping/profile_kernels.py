"""What the profile of a pulse says by itself, and which cells its beam lights, as machine code."""

from typing import no_type_check

import numpy as np

from sionna_radar.elevation.ray_march import height_at
from sionna_radar.foundation.compiled import compiled

# One cell of pure noise in 10^13 exceeds this many means.
OUT_OF_NOISE = 30.0
TINY = 2.3e-308


@compiled
@no_type_check
def echo_level(power, noise, volume):
    """Return the level of a box with the echo's power, from E[P^2] = 2 E[P]^2; 0 if nothing exceeds the noise."""
    square, total = 0.0, 0.0
    for c in range(len(power)):
        above = power[c] - volume[c] - OUT_OF_NOISE * noise
        if above > 0.0:
            square += above * above
            total += above
    return square / total / 2 if total > 0 else 0.0


@compiled
@no_type_check
def echo_levels(start, power, noise, volume, level):
    """Write the level of each profile; `volume` is the mean power of what is in front of the ground, by cell."""
    for pulse in range(len(level)):
        cells = slice(start[pulse], start[pulse + 1])
        level[pulse] = echo_level(power[cells], noise[pulse], volume[cells])


@compiled
@no_type_check
def mean_cells(start, power, noise, looks, below_peak, mean, sigma):
    """Write the mean cell of each profile's power and its standard deviation, in cells.

    Of an echo of few looks the mean follows the strong ones, and the scatter about it comes out too small, as that of
    any sample does: by the share of one look in all, to first order.
    """
    for pulse in range(len(mean)):
        peak = 0.0
        for k in range(start[pulse], start[pulse + 1]):
            peak = max(peak, power[k])
        least, total, moment = max(below_peak * peak, OUT_OF_NOISE * noise[pulse]), 0.0, 0.0
        for k in range(start[pulse], start[pulse + 1]):
            if power[k] >= least:
                total += power[k]
                moment += power[k] * float(k - start[pulse])
        total = max(total, TINY)
        centre, square, alone = moment / total, 0.0, 0.0
        for k in range(start[pulse], start[pulse + 1]):
            if power[k] >= least:
                square += (float(power[k]) * (k - start[pulse] - centre)) ** 2
                alone += float(power[k]) ** 2
        # The mean square of an exponential power is twice the square of its mean.
        share = alone / total / total / (2 * looks)
        mean[pulse], sigma[pulse] = centre, np.sqrt(square / 2 / looks * (1 + share)) / total


@compiled
@no_type_check
def lit_cells(
    height, west, south, spacing, position, direction, range_m, corner, weight, off_m, grid, seen_by, found, pulse_of
):
    """Write the cells of a grid that samples of the beam light, once for each pulse; return how many there are.

    grid: west, south, spacing, rows, columns; seen_by: for each cell the last pulse that lit it, or -1; found,
    pulse_of: the cell, by its number, and the pulse.
    """
    used = 0
    for pulse in range(len(position)):
        at = position[pulse]
        for k in range(len(corner)):
            near, east, north, up, whole = 0.0, 0.0, 0.0, 0.0, True
            for c in range(4):
                node = corner[k, c]
                whole &= not np.isnan(range_m[pulse, node])
                near += weight[k, c] / range_m[pulse, node]
                east += weight[k, c] * direction[pulse, node, 0]
                north += weight[k, c] * direction[pulse, node, 1]
                up += weight[k, c] * direction[pulse, node, 2]
            if not whole:
                continue
            x, y, z = at[0] + east / near, at[1] + north / near, at[2] + up / near
            if abs(z - height_at(height, west, south, spacing, x, y)) >= off_m:
                continue
            column, row = int(np.rint((x - grid[0]) / grid[2])), int(np.rint((y - grid[1]) / grid[2]))
            if row < 0 or column < 0 or row >= grid[3] or column >= grid[4]:
                continue
            cell = row * grid[4] + column
            if seen_by[cell] != pulse:
                seen_by[cell] = pulse
                found[used], pulse_of[used] = cell, pulse
                used += 1
    return used
