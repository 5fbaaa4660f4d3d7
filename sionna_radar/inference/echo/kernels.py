"""Numba kernels of the echo model: likelihood of range profiles, its score and curvature.

Every function writes the rows of its own pulses, from those alone. Cells are numbered from the first of a
profile, with a margin of `pad` cells on both sides for the response of the window. The response is that of cells over
which power is spread as by a cubic B-spline; see `model.spline_taps`.

What each cell gains by more power is handed back to the cells that power leaves, from these to the samples of the beam,
and from those to the nodes around: as much work as the prediction itself.
"""

from typing import no_type_check

import numpy as np

from sionna_radar.foundation.compiled import compiled
from sionna_radar.foundation.numerics import MAX_SPECKLE
from sionna_radar.inference.echo.power_kernels import (
    beam_samples,
    echo_level,
    in_double,
    moved_power,
    passed_borders,
    pull_of_cells,
    sample_power,
    spread_power,
)

# Power relative to the echo's level at which the weight of a cell is 1/4.
FADING_LEVEL = 0.02
# Power of a cell that no model of the surface explains, relative to the strongest: where a level is fitted.
LEVEL_PEDESTAL = 1e-4
MIN_WEIGHT = 1e-4
# Tolerance of a level, Np: so small that the number of iterations does not move the surface.
LEVEL_ITERATIONS, LEVEL_TOLERANCE = 30, 1e-7
# Smallest spread of the volume's drift that is modelled, cells.
MIN_SPREAD_CELLS = 0.05
MIN_CELLS = 2
# Cells beyond a profile, more than the response of the window reaches, from which samples still reach into it.
BEYOND = 3


@compiled
@no_type_check
def _weigh(level, shape, volume, noise, top, mean, weight):
    for c in range(len(shape)):
        signal = level * shape[c] + volume[c]
        mean[c] = signal + noise
        weight[c] = (signal / (signal + FADING_LEVEL * top)) ** 2


@compiled
@no_type_check
def fit_level(power, shape, volume, noise, top, mean, weight):
    """Return the most likely level of an echo; write the mean powers and weights of the cells at that level."""
    level, unit = 0.0, 0.0
    low, high = len(shape), 0
    for c in range(len(shape)):
        level += power[c]
        unit += shape[c]
        if shape[c] > 0.0:
            low, high = min(low, c), c + 1
    level /= unit
    for _ in range(LEVEL_ITERATIONS):
        pull, total = 0.0, 0.0
        for c in range(low, high):
            own = level * shape[c]
            signal = own + volume[c]
            inverse, damping = 1 / (signal + noise), signal / (signal + FADING_LEVEL * top)
            part = damping * damping * own * inverse
            pull += part * (min(power[c] * inverse, MAX_SPECKLE) - 1)
            total += part
        step = pull / max(total, 2.2e-308)
        level *= np.exp(min(max(step, -1.0), 1.0))
        if abs(step) < LEVEL_TOLERANCE:
            break
    _weigh(level, shape, volume, noise, top, mean, weight)
    return level


@compiled
@no_type_check
def _filtered(values, taps, begin, end):
    """Return the columns of (row, n) filtered by an odd number of taps, constant beyond the ends; some rows of it."""
    rows, half = len(values), len(taps) // 2
    result = np.zeros((end - begin, values.shape[1]))
    for row in range(begin, end):
        for tap in range(len(taps)):
            source, factor = min(max(row + half - tap, 0), rows - 1), taps[tap]
            for column in range(values.shape[1]):
                result[row - begin, column] += factor * values[source, column]
    return result


@compiled
@no_type_check
def _gaussian(sigma):
    half = int(4 * sigma + 0.5)
    taps, total = np.empty(2 * half + 1), 0.0
    for tap in range(len(taps)):
        taps[tap] = np.exp(-0.5 * ((tap - half) / sigma) ** 2)
        total += taps[tap]
    for tap in range(len(taps)):
        taps[tap] /= total
    return taps


@compiled
@no_type_check
def _up_to_middle(values):
    """Replace the rows by their cumulative sums up to the middle of each."""
    total = np.zeros(values.shape[1])
    for row in range(len(values)):
        for column in range(values.shape[1]):
            own = values[row, column]
            total[column] += own
            values[row, column] = total[column] - own / 2


@compiled
@no_type_check
def _volume(power, beam_power, before, cell, near, lattice, first, half, cell_m, response, sigma, scale):
    """Return the mean power of a volume in front of the ground, and its change with the heights under the nodes.

    The columns are first the beam that has met the surface, less all of it, which is the beam still in the air.
    """
    cells, pad, nodes = len(power), half + BEYOND, len(scale)
    size = cells + 2 * pad
    hit, onto = np.zeros(size), np.zeros((size, nodes))
    nearest, farthest = spread_power(beam_power, cell, first, cells, pad, hit)
    moved_power(beam_power / near**2 / cell_m, cell, lattice, first, cells, pad, nearest, farthest, onto)
    both = np.empty((size, nodes + 1))
    for row in range(size):
        both[row, 0] = hit[row]
        for node in range(nodes):
            from_below = onto[row - 1, node] if row else 0.0
            both[row, node + 1] = (from_below - onto[row, node]) * scale[node]
    _up_to_middle(both)
    for row in range(size):
        both[row, 0] -= 1 - before
    if sigma > MIN_SPREAD_CELLS:
        both = _filtered(both, _gaussian(sigma), np.int64(0), size)
    both = _filtered(both, response, pad, pad + cells)
    total = 0.0
    for tap in range(len(response)):
        total += response[tap]
    for row in range(cells):
        for column in range(nodes + 1):
            both[row, column] *= -power[row] / total
    return both


@compiled
@no_type_check
def _jacobian(onto, added, low, high, response, scale, row, result):
    """Write the derivative of one cell's power by the heights under the nodes, spread by the window.

    Of power that is moved, and of power that is added where a border of covers passes; see `passed_borders`.
    """
    half = len(response) // 2
    pad = half + BEYOND
    for node in range(len(result)):
        result[node] = 0.0
    for source in range(max(row + pad - half - 1, low), min(row + pad + half, high) + 1):
        # Power that leaves `source` arrives in the cell beyond it.
        leaving, arriving = row + pad - source + half, row + pad - source - 1 + half
        factor = response[arriving] if 0 <= arriving < len(response) else 0.0
        factor -= response[leaving] if 0 <= leaving < len(response) else 0.0
        for node in range(len(result)):
            result[node] += factor * onto[source, node]
    for node in range(len(result)):
        result[node] *= scale[node]
    if len(added) > 0:
        for source in range(max(row + pad - half, low), min(row + pad + half, high + 1) + 1):
            factor = response[row + pad - source + half]
            for node in range(len(result)):
                result[node] += factor * added[source, node]


@compiled
@no_type_check
def volume_in_front(low, high, data, clutter, geometry, antenna, result):
    """Write the mean power of the volume before echoes, and its change with the heights under the nodes.

    data, geometry, antenna: see `linearise`; clutter: power of the volume, its drift and spread.
    result: by range cell, those of the pulse `low` first: the power, and then the changes.
    """
    first, start, _, _, _, cell_m = data
    volume_power, drift, sigma = clutter
    range_m, shift, per_height, _ = geometry
    beam_power, lattice, response = antenna
    cell, near, inverse = np.empty(len(beam_power)), np.empty(len(beam_power)), np.empty(range_m.shape[1])
    scale, half = np.empty(len(inverse)), len(response) // 2
    for pulse in range(low, high):
        begin = float(first[pulse])
        beam_samples(range_m[pulse], shift[pulse], lattice, cell_m, drift[pulse], cell, near, inverse)
        for node in range(len(scale)):
            scale[node] = 0.0 if np.isnan(inverse[node]) else inverse[node] ** 2 * per_height[pulse, node]
        before = 0.0
        for k in range(len(beam_power)):
            if cell[k] <= begin - (half + BEYOND - 1):
                before += beam_power[k]
        volume_cells = in_double(volume_power, start[pulse], start[pulse + 1])
        mean = _volume(
            volume_cells, beam_power, before, cell, near, lattice, begin, half, cell_m, response, sigma, scale
        )
        for row in range(len(mean)):
            for column in range(mean.shape[1]):
                result[start[pulse] - start[low] + row, column] = mean[row, column]


@compiled
@no_type_check
def _changes(echo, onto, added, nearest, farthest, response, scale, in_front, jacobian, along_level):
    """Write the derivatives of log powers by the heights under the nodes, in the cells that count, and of the level.

    Returns the number of cells that count; 0 for too few.
    """
    level, shape, mean, weight = echo
    rows = 0
    for c in range(len(shape)):
        rows += weight[c] > MIN_WEIGHT
    if rows < MIN_CELLS:
        return 0
    row = 0
    along_level[:] = 0.0
    for c in range(len(shape)):
        if weight[c] <= MIN_WEIGHT:
            continue
        _jacobian(onto, added, nearest, farthest, response, scale, c, jacobian[row])
        by_level = weight[c] * level * shape[c] / mean[c]
        for node in range(len(along_level)):
            if len(in_front) > 0:
                jacobian[row, node] += in_front[c, node + 1] / level
            jacobian[row, node] *= level / mean[c]
            along_level[node] += by_level * jacobian[row, node]
        row += 1
    return rows


@compiled
@no_type_check
def _whitened(echo, power, looks, jacobian, along_level, score, factor, one_of, residual, weight_of):
    """Write the score of an echo, the rows of its factor, whitened residuals and weights, all free of the level.

    one_of: of so many rows the factor keeps one, from the given on, in place of all of these.
    """
    level, shape, mean, weight = echo
    together, offset = one_of
    of_level = 0.0
    for c in range(len(shape)):
        if weight[c] > MIN_WEIGHT:
            of_level += weight[c] * (level * shape[c] / mean[c]) ** 2
    row, scale = 0, np.sqrt(together)
    for c in range(len(shape)):
        if weight[c] <= MIN_WEIGHT:
            continue
        # The part of the change that a change of the echo's level explains is projected out.
        level_slope = level * shape[c] / mean[c] / max(of_level, 2.2e-308)
        root = np.sqrt(looks * weight[c])
        rest = root * (min(power[c] / mean[c], MAX_SPECKLE) - 1)
        residual[row] = rest
        weight_of[row] = weight[c]
        for node in range(len(along_level)):
            whitened = root * (jacobian[row, node] - level_slope * along_level[node])
            if row % together == offset:
                factor[row // together, node] = whitened * scale
            score[node] += rest * whitened
        row += 1


@compiled
@no_type_check
def predicted(pulse, data, geometry, antenna, samples, power, moved, scale, hit, shape):
    """Write the shape of an echo; return the first and the last cell that power leaves, and slopes as `sample_power`.

    moved: written, the power of each sample that its 1 / range moves from cell to cell; scale: by how much 1 / range
    under the nodes changes with the height there; hit: room for the power on the cells.
    """
    first, _, _, _, _, cell_m = data
    range_m, shift, per_height, ground = geometry
    beam_power, lattice, response = antenna
    beam_power, slope = sample_power(pulse, beam_power, ground, lattice)
    cell, near, inverse = samples
    half = len(response) // 2
    pad = half + BEYOND
    middle = beam_samples(range_m[pulse], shift[pulse], lattice, cell_m, 0.0, cell, near, inverse)
    for node in range(len(scale)):
        scale[node] = 0.0 if np.isnan(inverse[node]) else inverse[node] ** 2 * per_height[pulse, node]
    for k in range(len(beam_power)):
        moved[k] = beam_power[k] * (middle * middle / cell_m)
        power[k] = beam_power[k] * (middle * near[k]) ** 2
    for k in range(len(slope)):
        slope[k, 0] *= (middle * near[k]) ** 2
        slope[k, 1] *= (middle * near[k]) ** 2
    nearest, farthest = spread_power(power, cell, float(first[pulse]), len(shape), pad, hit)
    for c in range(len(shape)):
        shape[c] = 0.0
        for tap in range(len(response)):
            shape[c] += response[tap] * hit[c + pad + half - tap]
        # Beside a sharp edge splines swing a little below zero.
        shape[c] = max(shape[c], 0.0)
    return nearest, farthest, slope


@compiled
@no_type_check
def _peak(values):
    peak = 0.0
    for value in values:
        peak = max(peak, value)
    return peak


@compiled
@no_type_check
def linearise(low, high, data, in_front, geometry, antenna, results):
    """Write score, rows of the factor, whitened residuals, their weights, and the number of rows, of some pulses.

    data: first cell, start of the cells' powers, these, noise, looks, and the length of a cell.
    in_front: see `volume_in_front`; empty where there is no volume. geometry: see `meet` and `sample_power`.
    antenna: samples of the beam's power, the nodes around each and their weights, and the response of the window.
    results: and of how many rows the factor keeps one, where there is room for the rows of each pulse, and for
        those that the factor keeps.
    """
    _, start, profile_power, profile_noise, looks, _ = data
    score, factor, together, residual, weight_of, count, begin, begin_factor = results
    nodes, half, number = score.shape[1], len(antenna[2]) // 2, len(antenna[0])
    samples, strength, moved = (np.empty(number), np.empty(number), np.empty(nodes)), np.empty(number), np.empty(number)
    scale, own = np.empty(nodes), np.empty(nodes)
    most = 1
    for pulse in range(low, high):
        most = max(most, start[pulse + 1] - start[pulse])
    room, all_hit = np.empty((most + 2 * (half + BEYOND), nodes)), np.empty(most + 2 * (half + BEYOND))
    all_added = np.empty(room.shape)
    jacobian, all_shape = np.empty((most, nodes)), np.empty(most)
    for pulse in range(low, high):
        score[pulse, :] = 0.0
        count[pulse] = 0
        power = in_double(profile_power, start[pulse], start[pulse + 1])
        cells, noise = len(power), profile_noise[pulse]
        size = cells + 2 * (half + BEYOND)
        shape = all_shape[:cells]
        nearest, farthest, slope = predicted(
            pulse, data, geometry, antenna, samples, strength, moved, scale, all_hit[:size], shape
        )
        if _peak(shape) <= 0.0:
            continue
        pad = half + BEYOND
        moved_power(moved, samples[0], antenna[1], float(data[0][pulse]), cells, pad, nearest, farthest, room[:size])
        added = all_added[: size if np.any(slope != 0.0) else 0]
        if len(added) > 0:
            passed_borders(pulse, geometry, slope, samples[0], antenna[1], float(data[0][pulse]), cells, pad, added)
        before, volume = in_front[start[pulse] - start[low] : start[pulse + 1] - start[low]], np.empty(cells)
        for c in range(cells):
            volume[c] = before[c, 0] if len(before) > 0 else 0.0
        top = echo_level(power, noise, volume)
        if top == 0.0:
            continue
        mean, weight = np.empty(cells), np.empty(cells)
        level = fit_level(power, shape, volume, noise + LEVEL_PEDESTAL * top, top, mean, weight)
        echo = level, shape, mean, weight
        rows = _changes(echo, room, added, nearest, farthest, antenna[2], scale, before, jacobian, own)
        if rows > 0:
            to, kept = slice(begin[pulse], begin[pulse] + rows), slice(begin_factor[pulse], begin_factor[pulse + 1])
            one_of = together, pulse % together
            _whitened(
                echo,
                power,
                looks[pulse],
                jacobian,
                own,
                score[pulse],
                factor[kept],
                one_of,
                residual[to],
                weight_of[to],
            )
        count[pulse] = rows


@compiled
@no_type_check
def _gain_of_cells(power, echo, looks, gain):
    """Write the derivative of the log-likelihood by the power of each cell, with the echo's level projected out.

    Returns the number of cells that count.
    """
    level, shape, mean, weight = echo
    rows, of_level, pulled = 0, 0.0, 0.0
    for c in range(len(shape)):
        gain[c] = 0.0
        if weight[c] > MIN_WEIGHT:
            rows += 1
            level_fraction = level * shape[c] / mean[c]
            rest = looks * weight[c] * (min(power[c] / mean[c], MAX_SPECKLE) - 1)
            of_level += weight[c] * level_fraction * level_fraction
            pulled += rest * level_fraction
            gain[c] = rest * level / mean[c]
    for c in range(len(shape)):
        if weight[c] > MIN_WEIGHT:
            gain[c] -= pulled / max(of_level, 2.2e-308) * weight[c] * shape[c] * (level / mean[c]) ** 2
    return rows


@compiled
@no_type_check
def scores(low, high, data, geometry, antenna, score):
    """Write the score of the pulses from `low` to `high`; see `linearise`."""
    first, start, profile_power, profile_noise, looks, _ = data
    beam_power, lattice, response = antenna
    nodes, number, half = score.shape[1], len(beam_power), len(response) // 2
    pad, most = half + BEYOND, 1
    for pulse in range(low, high):
        most = max(most, start[pulse + 1] - start[pulse])
    samples, strength, moved = (np.empty(number), np.empty(number), np.empty(nodes)), np.empty(number), np.empty(number)
    scale, all_hit, all_gained = np.empty(nodes), np.empty(most + 2 * pad), np.empty(most + 2 * pad)
    all_cells, all_added = np.empty((4, most)), np.empty((most + 2 * pad, nodes))
    volume = np.zeros(most)
    for pulse in range(low, high):
        score[pulse, :] = 0.0
        power = in_double(profile_power, start[pulse], start[pulse + 1])
        cells = len(power)
        hit, gained = all_hit[: cells + 2 * pad], all_gained[: cells + 2 * pad]
        shape, mean, weight, gain = (
            all_cells[0, :cells],
            all_cells[1, :cells],
            all_cells[2, :cells],
            all_cells[3, :cells],
        )
        _, _, slope = predicted(pulse, data, geometry, antenna, samples, strength, moved, scale, hit, shape)
        if _peak(shape) <= 0.0:
            continue
        top = echo_level(power, profile_noise[pulse], volume[:cells])
        if top == 0.0:
            continue
        noise = profile_noise[pulse] + LEVEL_PEDESTAL * top
        level = fit_level(power, shape, volume[:cells], noise, top, mean, weight)
        if _gain_of_cells(power, (level, shape, mean, weight), looks[pulse], gain) < MIN_CELLS:
            continue
        # Power that leaves a cell arrives in the one beyond it; both are spread by the window.
        gained[:] = 0.0
        for c in range(cells):
            for tap in range(len(response)):
                place = c + pad + half - tap
                gained[place] -= response[tap] * gain[c]
                gained[place - 1] += response[tap] * gain[c]
        pull_of_cells(gained, moved, samples[0], lattice, float(first[pulse]), cells, pad, score[pulse])
        for node in range(nodes):
            score[pulse, node] *= scale[node]
        if np.any(slope != 0.0):
            added = all_added[: cells + 2 * pad]
            passed_borders(pulse, geometry, slope, samples[0], lattice, float(first[pulse]), cells, pad, added)
            for c in range(cells):
                for tap in range(len(response)):
                    factor = response[tap] * gain[c]
                    for node in range(nodes):
                        score[pulse, node] += factor * added[c + pad + half - tap, node]
