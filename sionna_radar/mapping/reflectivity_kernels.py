"""How bright the parts of a map are and their walls, given the map, as machine code; see `borders`."""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float32, Int32

from sionna_radar.foundation.compiled import compiled
from sionna_radar.mapping.border_kernels import HIGHEST_RATIO, landing, predict_cells, ray
from sionna_radar.mapping.column_kernels import NOTHING


class Landings(NamedTuple):
    """Where the rays that were cast fall in the profiles, whatever the reflectivities.

    cell: the first of the two range cells of each ray, NOTHING outside the profile; beyond: the share of the second.
    fall: by how much power falls with the range; top: number of the map cell whose top it meets, or NOTHING.
    """

    cell: Int32[np.ndarray, "pulse sample"]
    beyond: Float32[np.ndarray, "pulse sample"]
    fall: Float32[np.ndarray, "pulse sample"]
    top: Int32[np.ndarray, "pulse sample"]


def unknown_landings(shape: tuple[int, int]) -> Landings:
    """Return landings not yet computed."""
    return Landings(
        cell=np.empty(shape, dtype=np.int32),
        beyond=np.empty(shape, dtype=np.float32),
        fall=np.empty(shape, dtype=np.float32),
        top=np.empty(shape, dtype=np.int32),
    )


@compiled
@no_type_check
def land(columns, views, echoes, landings, low, high):
    """Compute where the rays of some pulses fall."""
    rows, count = columns.height.shape
    for pulse in range(low, high):
        x, y = views.position[pulse, 0], views.position[pulse, 1]
        for k in range(len(views.share)):
            what, meets = views.what[pulse, k], views.meets[pulse, k]
            cell, beyond, fall = landing(views, echoes, pulse, k, meets, what)
            landings.cell[pulse, k], landings.beyond[pulse, k], landings.fall[pulse, k] = cell, beyond, fall
            landings.top[pulse, k] = NOTHING
            if cell != NOTHING and what % 2 == 0:
                dx, dy, _ = ray(views, pulse, k)
                i = int(np.floor((y + meets * dy - columns.south) / columns.spacing))
                j = int(np.floor((x + meets * dx - columns.west) / columns.spacing))
                if 0 <= i < rows and 0 <= j < count:
                    landings.top[pulse, k] = i * count + j


@compiled
@no_type_check
def predict(views, echoes, landings, level, low, high):
    """Predict the profiles of some pulses."""
    pad = 2 * (len(echoes.response) // 2) + 1
    for pulse in range(low, high):
        begin, end = echoes.start[pulse], echoes.start[pulse + 1]
        hits = echoes.hits[begin + 2 * pad * pulse : end + 2 * pad * (pulse + 1)]
        hits[:] = 0.0
        for k in range(len(views.share)):
            cell = landings.cell[pulse, k]
            if cell == NOTHING:
                continue
            power = level[views.what[pulse, k]] * views.share[k] * landings.fall[pulse, k]
            beyond = landings.beyond[pulse, k]
            hits[cell] += power * (1 - beyond)
            hits[cell + 1] += power * beyond
        predict_cells(echoes, pulse, hits, 0, end - begin, echoes.mean[begin:end])


@compiled
@no_type_check
def shares(views, echoes, landings, level, found, expected, cell_found, cell_expected, by_cell, low, high):
    """Add up, of each part and its walls, by how much measured power exceeds the mean, and what was expected.

    Of the two sums, over the powers P that a reflectivity adds p to: p P / mean^2, and p / mean. The same by map cell
    if that is asked for.
    """
    half = len(echoes.response) // 2
    pad = 2 * half + 1
    for pulse in range(low, high):
        begin, end = echoes.start[pulse], echoes.start[pulse + 1]
        excess, inverse = np.zeros(end - begin + 2 * pad), np.zeros(end - begin + 2 * pad)
        usual_there, more_there = np.empty(end - begin), np.empty(end - begin)
        for cell in range(end - begin):
            usual_there[cell] = 1 / echoes.mean[begin + cell]
            more_there[cell] = min(echoes.power[begin + cell] * usual_there[cell], HIGHEST_RATIO) * usual_there[cell]
        for tap in range(len(echoes.response)):
            weight, first = echoes.response[tap], 3 * half + 1 - tap
            for cell in range(end - begin):
                excess[cell + first] += weight * more_there[cell]
                inverse[cell + first] += weight * usual_there[cell]
        for k in range(len(views.share)):
            at = landings.cell[pulse, k]
            if at == NOTHING:
                continue
            what, beyond = views.what[pulse, k], landings.beyond[pulse, k]
            power = level[what] * views.share[k] * landings.fall[pulse, k]
            nearer, farther = power * (1 - beyond), power * beyond
            more = nearer * excess[at] + farther * excess[at + 1]
            usual = nearer * inverse[at] + farther * inverse[at + 1]
            found[what] += more
            expected[what] += usual
            top = landings.top[pulse, k]
            if by_cell and top != NOTHING:
                cell_found[top] += more
                cell_expected[top] += usual
