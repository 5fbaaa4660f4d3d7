"""Where a beam meets a surface, and in which range cells its power falls, as machine code, pulse by pulse.

Cells are numbered from the first of a profile, with a margin of `pad` cells on both sides for the response of the
window; see `echo_kernels`.
"""

from typing import no_type_check

import numpy as np

from sionna_radar.elevation.ray_march import first_hit, slope_at
from sionna_radar.foundation.compiled import compiled

STEEPEST = 0.05


@compiled
@no_type_check
def meet(
    height, west, south, spacing, steepest, highest, position, velocity, R_world_antenna, beam, wanted, doppler, reach,
    range_m, place, per_height, shift, low, high,
):  # fmt: skip
    """Cast the nodes of the pulses from `low` to `high` on a surface.

    wanted: whether a node is; the others count as meeting nothing.
    doppler: by how much a range rate of 1 m/s lengthens a range.
    Writes range, place, change of range with the height there, and by how much motion lengthens the range.
    """
    ray = np.empty(3)
    for pulse in range(low, high):
        origin = position[pulse]
        for node in range(len(beam)):
            closing_in = 0.0
            for k in range(3):
                ray[k] = 0.0
                for c in range(3):
                    ray[k] += R_world_antenna[pulse, k, c] * beam[node, c]
                closing_in += velocity[pulse, k] * ray[k]
            shift[pulse, node] = -doppler * closing_in
            hit = np.nan
            if wanted[node]:
                hit = first_hit(height, west, south, spacing, origin, ray, reach, steepest, highest)
            there = 0.0 if np.isnan(hit) else hit
            place[pulse, node, 0] = origin[0] + there * ray[0]
            place[pulse, node, 1] = origin[1] + there * ray[1]
            east, north = slope_at(height, west, south, spacing, place[pulse, node, 0], place[pulse, node, 1])
            # On the ray z + r d_z = h(x + r d_x, y + r d_y): raising h shortens r by 1 / (d_z - slope . d_xy) < 0.
            closing = min(ray[2] - east * ray[0] - north * ray[1], -STEEPEST)
            per_height[pulse, node] = 0.0 if np.isnan(hit) else 1 / closing
            range_m[pulse, node] = hit


@compiled
@no_type_check
def beam_samples(range_m, shift, share, corner, weight, cell_m, drift_m, cell, sample_range, inverse):
    """Write range and range cell of every sample of a beam, NaN off the surface; return the mean range of the nodes."""
    total, met = 0.0, 0
    for node in range(len(range_m)):
        hit = range_m[node]
        inverse[node] = 0.0
        if not np.isnan(hit):
            inverse[node] = 1 / max(hit, 1.0)
            total += hit
            met += 1
    for k in range(len(share)):
        near, moved, whole = 0.0, 0.0, True
        for c in range(4):
            node = corner[k, c]
            whole &= inverse[node] > 0.0
            near += weight[k, c] * inverse[node]
            moved += weight[k, c] * shift[node]
        sample_range[k] = 1 / max(near, 1e-6)
        cell[k] = (sample_range[k] + moved + drift_m) / cell_m if whole else np.nan
    return total / met if met else np.nan


@compiled
@no_type_check
def centroids(low, high, range_m, shift, share, corner, weight, cell_m, mean):
    """Write the power-weighted mean range of the echoes from `low` to `high`; NaN without one."""
    nodes, samples = range_m.shape[1], len(share)
    cell, sample_range, inverse = np.empty(samples), np.empty(samples), np.empty(nodes)
    for pulse in range(low, high):
        beam_samples(range_m[pulse], shift[pulse], share, corner, weight, cell_m, 0.0, cell, sample_range, inverse)
        total, moment = 0.0, 0.0
        for k in range(samples):
            if not np.isnan(cell[k]):
                power = share[k] / sample_range[k] ** 2
                total += power
                moment += power * cell[k]
        mean[pulse] = moment / total * cell_m if total > 0 else np.nan


@compiled
@no_type_check
def spread_power(power, cell, sample_range, corner, weight, first, cells, pad, cell_m, hit, onto):
    """Write what power of samples falls on the cells around each, and how raised nodes move it up by a cell.

    Each sample is spread as a cubic B-spline is, whose growth is a quadratic one less the same a cell beyond: so the
    likelihood of an echo has no kinks where samples pass from cell to cell, and its maximum can be found.
    pad: cells on both sides of the profile; samples count as far as one less beyond it.
    Returns the first and the last cell that power leaves; `onto` is written there and between only.
    """
    hit[:] = 0.0
    nearest, farthest = len(hit), -1
    for k in range(len(power)):
        if first - pad + 1 < cell[k] < first + cells + pad - 2:
            below = int(np.floor(cell[k] - first)) + pad
            nearest, farthest = min(nearest, below - 1), max(farthest, below + 1)
    onto[nearest : farthest + 1] = 0.0
    for k in range(len(power)):
        place = cell[k]
        if not first - pad + 1 < place < first + cells + pad - 2:
            continue
        below = int(np.floor(place - first))
        a = place - first - below
        b = 1 - a
        below += pad
        hit[below - 1] += power[k] * (b * b * b / 6)
        hit[below] += power[k] * (2 / 3 - a * a * (1 - a / 2))
        hit[below + 1] += power[k] * (2 / 3 - b * b * (1 - b / 2))
        hit[below + 2] += power[k] * (a * a * a / 6)
        moved = power[k] * sample_range[k] ** 2 / cell_m
        from_before, from_beyond = moved * (b * b / 2), moved * (a * a / 2)
        from_below = moved - from_before - from_beyond
        for c in range(4):
            node, share = corner[k, c], weight[k, c]
            onto[below - 1, node] += share * from_before
            onto[below, node] += share * from_below
            onto[below + 1, node] += share * from_beyond
    return nearest, farthest
