"""Numba kernels of the echo model: intersections of beam and surface, and power per range cell.

Cells are numbered from the first of a profile, with a margin of `pad` cells on both sides for the response of the
window; see `kernels`.
"""

from typing import no_type_check

import numpy as np

from sionna_radar.elevation.heightfield import corner_of, first_hit, height_at, hit_near, slope_at
from sionna_radar.flight.frames import MIN_GRAZING_SINE
from sionna_radar.foundation.compiled import compiled


@compiled
@no_type_check
def meet(
    height, west, south, spacing, steepest, highest, position, velocity, R_world_antenna, beam, wanted, doppler, reach,
    guess, range_m, place, per_height, shift, low, high,
):  # fmt: skip
    """Cast the nodes of the pulses from `low` to `high` on a surface.

    wanted: whether a node is; the others count as meeting nothing.
    guess: ranges at which they met a surface that was nearly the same, or none.
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
            if len(guess) > 0 and not np.isnan(guess[pulse, node]):
                hit = hit_near(height, west, south, spacing, origin, ray, guess[pulse, node])
            if wanted[node] and np.isnan(hit):
                hit = first_hit(height, west, south, spacing, origin, ray, reach, steepest, highest)
            there = 0.0 if np.isnan(hit) else hit
            place[pulse, node, 0] = origin[0] + there * ray[0]
            place[pulse, node, 1] = origin[1] + there * ray[1]
            east, north = slope_at(height, west, south, spacing, place[pulse, node, 0], place[pulse, node, 1])
            # On the ray z + r d_z = h(x + r d_x, y + r d_y): raising h shortens r by 1 / (d_z - slope . d_xy) < 0.
            closing = min(ray[2] - east * ray[0] - north * ray[1], -MIN_GRAZING_SINE)
            per_height[pulse, node] = 0.0 if np.isnan(hit) else 1 / closing
            range_m[pulse, node] = hit


@compiled
@no_type_check
def beam_samples(range_m, shift, lattice, cell_m, drift_m, cell, inverse_range, inverse):
    """Write 1 / range and range cell of every sample of a beam, NaN off the surface; return the nodes' mean range.

    lattice: of the fine samples along each axis, azimuth first, the node below and how far it is toward the next.
    inverse: written, 1 / range of the nodes.
    """
    low_u, part_u, low_v, part_v = lattice
    nodes, along, k = low_v[-1] + 2, len(low_v), 0
    total, met = 0.0, 0
    for node in range(len(range_m)):
        hit = range_m[node]
        inverse[node] = 1 / max(hit, 1.0)
        if not np.isnan(hit):
            total += hit
            met += 1
        else:
            inverse[node] = np.nan
    near, moved = np.empty(nodes), np.empty(nodes)
    for i in range(len(low_u)):
        first, b = low_u[i] * nodes, part_u[i]
        for node in range(first, first + nodes):
            near[node - first] = inverse[node] * (1 - b) + inverse[node + nodes] * b
            moved[node - first] = shift[node] * (1 - b) + shift[node + nodes] * b
        for j in range(along):
            node, a = low_v[j], part_v[j]
            interpolated = near[node] * (1 - a) + near[node + 1] * a
            inverse_range[k] = interpolated
            cell[k] = (1 / interpolated + moved[node] * (1 - a) + moved[node + 1] * a + drift_m) / cell_m
            k += 1
    return total / met if met else np.nan


@compiled
@no_type_check
def sample_power(pulse, beam_power, ground, lattice):
    """Return the power of the samples of a beam, times the known backscatter of the ground, and its slopes.

    The slopes are by the place of each sample, east and north, 1/m; none for one backscatter. Between the middles of
    cells the backscatter is bilinear, so that a border passes by samples without a jump.

    ground: where the nodes of all pulses meet it, its cover by cells of a grid with their west, south and spacing, the
        level of each cover for each pulse, of no covers where one backscatter is taken for all of a footprint, and
        from where each pulse was sent.
    """
    place, cover, west, south, spacing, level, _ = ground
    if level.shape[1] == 0:
        return beam_power, np.empty((0, 2))
    low_u, part_u, low_v, part_v = lattice
    nodes, along, lit, slope = low_v[-1] + 2, len(low_v), np.empty(len(beam_power)), np.empty((len(beam_power), 2))
    rows, columns = cover.shape
    for i in range(len(low_u)):
        b = part_u[i]
        for j in range(along):
            a, k, sample = part_v[j], low_u[i] * nodes + low_v[j], i * along + j
            corner = (1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b
            x = y = 0.0
            for c in range(4):
                node = k + c % 2 + c // 2 * nodes
                x += corner[c] * place[pulse, node, 0]
                y += corner[c] * place[pulse, node, 1]
            row, column, north, east = corner_of(x, y, west, south, spacing, rows, columns)
            here, beside = level[pulse, cover[row, column]], level[pulse, cover[row, column + 1]]
            beyond, across = level[pulse, cover[row + 1, column]], level[pulse, cover[row + 1, column + 1]]
            near, far = here + east * (beside - here), beyond + east * (across - beyond)
            lit[sample] = beam_power[sample] * (near + north * (far - near))
            eastward = beside - here + north * (across - beyond - beside + here)
            slope[sample, 0] = beam_power[sample] * eastward / spacing
            slope[sample, 1] = beam_power[sample] * (far - near) / spacing
    return lit, slope


@compiled
@no_type_check
def passed_borders(pulse, geometry, slope, cell, lattice, first, cells, pad, added):
    """Write the power that each cell gains as raised nodes move the samples of a beam over borders of covers.

    A raised node is met nearer, and so elsewhere: by its ray, as far as the range changes.
    slope: power of each sample by its place, east and north.
    """
    range_m, _, per_height, ground = geometry
    place, position = ground[0], ground[-1]
    low_u, part_u, low_v, part_v = lattice
    nodes, along = low_v[-1] + 2, len(low_v)
    added[:] = 0.0
    for i in range(len(low_u)):
        for j in range(along):
            k = i * along + j
            at = cell[k] - first
            if (slope[k, 0] == 0.0 and slope[k, 1] == 0.0) or not 1 - pad < at < cells + pad - 2:
                continue
            below = int(np.floor(at))
            a, b_u, b_v = at - below, part_u[i], part_v[j]
            b = 1 - a
            below += pad
            spread = b * b * b / 6, 2 / 3 - a * a * (1 - a / 2), 2 / 3 - b * b * (1 - b / 2), a * a * a / 6
            corner = (1 - b_v) * (1 - b_u), b_v * (1 - b_u), (1 - b_v) * b_u, b_v * b_u
            for c in range(4):
                node = low_u[i] * nodes + low_v[j] + c % 2 + c // 2 * nodes
                east = (place[pulse, node, 0] - position[pulse, 0]) / range_m[pulse, node] * slope[k, 0]
                north = (place[pulse, node, 1] - position[pulse, 1]) / range_m[pulse, node] * slope[k, 1]
                gain = corner[c] * per_height[pulse, node] * (east + north)
                for source in range(4):
                    added[below - 1 + source, node] += gain * spread[source]


@compiled
@no_type_check
def centroids(low, high, range_m, shift, ground, beam_power, lattice, cell_m, reach, mean):
    """Write the power-weighted mean range, up to the cell `reach`, of the echoes from `low` to `high`; NaN without."""
    nodes, samples = range_m.shape[1], len(beam_power)
    cell, near, inverse = np.empty(samples), np.empty(samples), np.empty(nodes)
    for pulse in range(low, high):
        beam_samples(range_m[pulse], shift[pulse], lattice, cell_m, 0.0, cell, near, inverse)
        lit, _ = sample_power(pulse, beam_power, ground, lattice)
        total, moment = 0.0, 0.0
        for k in range(samples):
            if cell[k] <= reach:
                power = lit[k] * near[k] ** 2
                total += power
                moment += power * cell[k]
        mean[pulse] = moment / total * cell_m if total > 0 else np.nan


@compiled
@no_type_check
def spread_power(power, cell, first, cells, pad, hit):
    """Write the power of samples on the cells around each; return the first and the last cell that power leaves.

    Each sample is spread as a cubic B-spline is, whose growth is a quadratic one less the same a cell beyond: so the
    likelihood of an echo has no kinks where samples pass from cell to cell, and its maximum can be found.
    pad: cells on both sides of the profile; samples count as far as one less beyond it.
    """
    hit[:] = 0.0
    nearest, farthest = len(hit), -1
    for k in range(len(power)):
        place = cell[k] - first
        if not 1 - pad < place < cells + pad - 2:
            continue
        below = int(np.floor(place))
        a = place - below
        b = 1 - a
        below += pad
        nearest, farthest = min(nearest, below - 1), max(farthest, below + 1)
        hit[below - 1] += power[k] * (b * b * b / 6)
        hit[below] += power[k] * (2 / 3 - a * a * (1 - a / 2))
        hit[below + 1] += power[k] * (2 / 3 - b * b * (1 - b / 2))
        hit[below + 2] += power[k] * (a * a * a / 6)
    return nearest, farthest


@compiled
@no_type_check
def moved_power(moved, cell, lattice, first, cells, pad, nearest, farthest, onto):
    """Write the power that raised nodes move up from each cell to the next, in the cells from nearest to farthest.

    moved: of each sample, by its own 1 / range, in cells.
    """
    low_u, part_u, low_v, part_v = lattice
    nodes, along = low_v[-1] + 2, len(low_v)
    onto[nearest : farthest + 1] = 0.0
    for i in range(len(low_u)):
        u, b_u = low_u[i] * nodes, part_u[i]
        for j in range(along):
            place = cell[i * along + j] - first
            if not 1 - pad < place < cells + pad - 2:
                continue
            below = int(np.floor(place))
            a = place - below
            below += pad
            node, b_v, power = u + low_v[j], part_v[j], moved[i * along + j]
            here, next_u, next_v = power * (1 - b_u) * (1 - b_v), power * b_u * (1 - b_v), power * (1 - b_u) * b_v
            both = power * b_u * b_v
            before, beyond = (1 - a) * (1 - a) / 2, a * a / 2
            for source in range(3):
                part = before if source == 0 else (beyond if source == 2 else 1 - before - beyond)
                row = below - 1 + source
                onto[row, node] += here * part
                onto[row, node + 1] += next_v * part
                onto[row, node + nodes] += next_u * part
                onto[row, node + nodes + 1] += both * part


@compiled
@no_type_check
def pull_of_cells(gained, moved, cell, lattice, first, cells, pad, pull):
    """Write the gain of raising each node, from the gain of power that moves up from a cell: see `moved_power`."""
    low_u, part_u, low_v, part_v = lattice
    nodes, along = low_v[-1] + 2, len(low_v)
    own = np.empty(nodes)
    pull[:] = 0.0
    for i in range(len(low_u)):
        own[:] = 0.0
        for j in range(along):
            place = cell[i * along + j] - first
            if not 1 - pad < place < cells + pad - 2:
                continue
            below = int(np.floor(place))
            a = place - below
            below += pad
            before, beyond = (1 - a) * (1 - a) / 2, a * a / 2
            gain = before * gained[below - 1] + (1 - before - beyond) * gained[below] + beyond * gained[below + 1]
            gain *= moved[i * along + j]
            own[low_v[j]] += gain * (1 - part_v[j])
            own[low_v[j] + 1] += gain * part_v[j]
        u, b = low_u[i] * nodes, part_u[i]
        for node in range(nodes):
            pull[u + node] += own[node] * (1 - b)
            pull[u + nodes + node] += own[node] * b


# One cell of pure noise in 10^13 exceeds this many means.
OUT_OF_NOISE = 30.0


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
def in_double(values, begin, end):
    """Return some of the values in double precision."""
    result = np.empty(end - begin)
    for k in range(begin, end):
        result[k - begin] = values[k]
    return result


@compiled
@no_type_check
def echo_levels(start, power, noise, volume, level):
    """Write the level of each profile; `volume` is the mean power of what is in front of the ground, by cell."""
    for pulse in range(len(level)):
        cells = in_double(power, start[pulse], start[pulse + 1])
        level[pulse] = echo_level(cells, noise[pulse], volume[start[pulse] : start[pulse + 1]])


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
        total = max(total, np.finfo(np.float64).tiny)
        centre, square, alone = moment / total, 0.0, 0.0
        for k in range(start[pulse], start[pulse + 1]):
            if power[k] >= least:
                square += (float(power[k]) * (k - start[pulse] - centre)) ** 2
                alone += float(power[k]) ** 2
        # The mean square of an exponential power is twice the square of its mean.
        variance = alone / total / total / (2 * looks)
        mean[pulse], sigma[pulse] = centre, np.sqrt(square / 2 / looks * (1 + variance)) / total


@compiled
@no_type_check
def lit_cells(
    height, west, south, spacing, position, direction, range_m, corner, weight, off_m, grid, seen_by, lit, pulse_of
):
    """Write the cells of a grid that samples of the beam light, once for each pulse; return how many there are.

    grid: west, south, spacing, rows, columns; seen_by: for each cell the last pulse that lit it, or -1; lit,
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
                lit[used], pulse_of[used] = cell, pulse
                used += 1
    return used
