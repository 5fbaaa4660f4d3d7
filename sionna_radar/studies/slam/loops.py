"""Places that a drive comes back to: turns far apart in time that lie on each other.

Candidates are turns that could have been at the same place by the uncertainty of the drive. The later one is laid on
the map of the turns around the earlier one from many places of that uncertainty; what lies there best, and well, is a
loop.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.ndimage import distance_transform_edt

from sionna_radar.studies.slam.motion import travelled_m
from sionna_radar.studies.slam.registration import MIN_PAIRS, Prior, Registered, register
from sionna_radar.studies.slam.surfaces import Surfaces, rotation

# Spacing of the places and headings that are tried; surfaces reach to their neighbours.
HEADING_STEP_RAD = float(np.deg2rad(2.0))
# Cells of the field in which places are tried, and most of its cells along a side.
CELL_M, MOST_CELLS = 1.0, 2000
# Tried places that are registered, the best first.
BEST = 3
# Standard deviations within which loops are looked for.
WITHIN_SIGMAS = 2.5


def candidates(
    states: Float[np.ndarray, "turn 6"],
    covariance: Float[np.ndarray, "turn 3 3"],
    *,
    apart_m: float,
    near_m: float,
    step_m: float,
) -> list[tuple[int, int]]:
    """Return pairs (later, earlier) of turns that may be at one place, the nearest earlier one of each.

    apart_m: way between them, at least. near_m: distance of their places, beyond what is uncertain between them.
    step_m: way between later turns that are looked at.
    """
    found, last_m = [], -np.inf
    way_m = travelled_m(states)
    variance = covariance[:, 0, 0] + covariance[:, 1, 1]
    for later in range(len(states)):
        earlier = int(np.searchsorted(way_m, way_m[later] - apart_m))
        if earlier == 0 or way_m[later] - last_m < step_m:
            continue
        distance = np.linalg.norm(states[:earlier, :2] - states[later, :2], axis=1)
        excess = distance - WITHIN_SIGMAS * np.sqrt(np.maximum(variance[later] - variance[:earlier], 0.0))
        nearest = int(np.argmin(excess))
        if excess[nearest] < near_m:
            found.append((later, nearest))
            last_m = way_m[later]
    return found


def close(
    turn: Surfaces,
    around: Sequence[Surfaces],
    expected: Float[np.ndarray, " 6"],
    sigma: tuple[float, float],
    *,
    reach_m: float,
) -> Registered | None:
    """Return the state in which a turn lies on a map best, near an expected one; None for too few surfaces.

    turn: in its vehicle's axes; around: on the map. sigma: of place (m) and heading (rad).
    """
    there = Surfaces.concatenate(around)
    if min(len(turn), len(there)) < MIN_PAIRS:
        return None
    wide = max(WITHIN_SIGMAS * sigma[0], reach_m)
    field, corner = _closeness(there, wide + float(np.abs(turn.mean_m).max()), reach_m)
    steps = np.arange(-np.ceil(wide / reach_m), np.ceil(wide / reach_m) + 1) * reach_m
    offsets = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 1, 2)
    turns = np.ceil(WITHIN_SIGMAS * sigma[1] / HEADING_STEP_RAD)
    starts = []
    for heading in np.arange(-turns, turns + 1) * HEADING_STEP_RAD:
        placed = turn.mean_m @ rotation(expected[2] + heading).T + expected[:2]
        cell = np.rint((placed + offsets - corner) / CELL_M).astype(np.int64)
        inside = np.all((cell >= 0) & (cell < field.shape), axis=-1)
        cell = np.where(inside[..., None], cell, 0)
        score = np.sum(np.where(inside, field[cell[..., 0], cell[..., 1]], 0.0), axis=1)
        best_of = np.argsort(-score)[:BEST]
        starts += [(float(score[k]), *offsets[k, 0].tolist(), float(heading)) for k in best_of]
    starts.sort(reverse=True)
    loose = np.diag(1 / np.array([wide, wide, max(sigma[1], HEADING_STEP_RAD), 0.3, 0.3, 0.03]) ** 2)
    best: Registered | None = None
    for _, x, y, heading in starts[:BEST]:
        start = expected + np.array([x, y, heading, 0.0, 0.0, 0.0])
        prior = Prior(mean=start, information=loose)
        found = register(turn, there, prior, reach_m=reach_m, twist=expected[3:])
        if best is None or found.score > best.score:
            best = found
    return best


def _closeness(
    there: Surfaces, margin_m: float, reach_m: float
) -> tuple[Float[np.ndarray, "row column"], Float[np.ndarray, " 2"]]:
    """Return the closeness of places around a map to its surfaces, 1 on one, and the place of the first cell."""
    margin_m = min(margin_m, MOST_CELLS * CELL_M / 4)
    corner = there.mean_m.min(axis=0) - margin_m
    size = np.ceil((there.mean_m.max(axis=0) + margin_m - corner) / CELL_M).astype(np.int64) + 1
    empty = np.ones(np.minimum(size, MOST_CELLS), dtype=bool)
    cell = np.minimum(np.rint((there.mean_m - corner) / CELL_M).astype(np.int64), np.array(empty.shape) - 1)
    empty[cell[:, 0], cell[:, 1]] = False
    away = distance_transform_edt(empty) * CELL_M
    return np.exp(-0.5 * (away / (reach_m / 2)) ** 2), corner
