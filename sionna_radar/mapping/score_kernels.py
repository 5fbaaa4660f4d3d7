"""The score of echoes alone, without the rows that make it, as machine code; see `echo_kernels`.

What each cell gains by more power is handed back to the cells that power leaves, from these to the samples of the beam,
and from those to the nodes around: as much work as the prediction itself.
"""

from typing import no_type_check

import numpy as np

from sionna_radar.foundation.compiled import compiled
from sionna_radar.mapping.echo_kernels import (
    BEYOND,
    FEWEST_CELLS,
    HIGHEST_RATIO,
    LEAST_WEIGHT,
    PEDESTAL,
    fit_level,
    in_double,
    predicted,
)
from sionna_radar.mapping.power_kernels import pull_of_cells
from sionna_radar.mapping.profile_kernels import echo_level


@compiled
@no_type_check
def _gain_of_cells(power, echo, looks, gain):
    """Write what the likelihood gains by more power in each cell, less what the echo's level explains of it.

    Returns the number of cells that count.
    """
    level, shape, mean, weight = echo
    rows, of_level, pulled = 0, 0.0, 0.0
    for c in range(len(shape)):
        gain[c] = 0.0
        if weight[c] > LEAST_WEIGHT:
            rows += 1
            share = level * shape[c] / mean[c]
            rest = looks * weight[c] * (min(power[c] / mean[c], HIGHEST_RATIO) - 1)
            of_level += weight[c] * share * share
            pulled += rest * share
            gain[c] = rest * level / mean[c]
    for c in range(len(shape)):
        if weight[c] > LEAST_WEIGHT:
            gain[c] -= pulled / of_level * weight[c] * shape[c] * (level / mean[c]) ** 2
    return rows


@compiled
@no_type_check
def scores(low, high, data, geometry, antenna, score):
    """Write the score of the pulses from `low` to `high`; see `linearise`."""
    first, start, profile_power, profile_noise, looks, _ = data
    share, lattice, response = antenna
    nodes, number, half = score.shape[1], len(share), len(response) // 2
    pad, most = half + BEYOND, 1
    for pulse in range(low, high):
        most = max(most, start[pulse + 1] - start[pulse])
    samples, strength, moved = (np.empty(number), np.empty(number), np.empty(nodes)), np.empty(number), np.empty(number)
    scale, all_hit, all_gained = np.empty(nodes), np.empty(most + 2 * pad), np.empty(most + 2 * pad)
    all_cells = np.empty((4, most))
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
        predicted(pulse, data, geometry, antenna, samples, strength, moved, scale, hit, shape)
        if cells == 0 or shape.max() <= 0.0:
            continue
        top = echo_level(power, profile_noise[pulse], volume[:cells])
        if top == 0.0:
            continue
        noise = profile_noise[pulse] + PEDESTAL * top
        level = fit_level(power, shape, volume[:cells], noise, top, mean, weight)
        if _gain_of_cells(power, (level, shape, mean, weight), looks[pulse], gain) < FEWEST_CELLS:
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
