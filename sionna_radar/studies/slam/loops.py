"""Places that a drive comes back to: turns far apart in time that lie on each other.

Candidates are turns that could have been at the same place by the uncertainty of the drive. The later one is laid on
the map of the turns around the earlier one from many places of that uncertainty; what lies there best, and well, is a
loop.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from sionna_radar.studies.slam.registration import MIN_PAIRS, Prior, Registered, register
from sionna_radar.studies.slam.surfaces import Surfaces, joined, rotation

# Spacing of the places and headings that are tried; surfaces reach to their neighbours.
HEADING_STEP_RAD = float(np.deg2rad(2.0))
# Stands for no partner.
FAR = 1e9
# Tried places that are registered, the best first.
BEST = 3
# Standard deviations within which loops are looked for.
WITHIN_SIGMAS = 2.5


def candidates(
    states: Float[np.ndarray, "turn 6"],
    covariance: Float[np.ndarray, "turn 6 6"],
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
    way_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(states[:, :2], axis=0), axis=1))])
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
    there = joined(around)
    if min(len(turn), len(there)) < MIN_PAIRS:
        return None
    tree = cKDTree(there.mean_m)
    wide = max(WITHIN_SIGMAS * sigma[0], reach_m)
    offsets = np.arange(-np.ceil(wide / reach_m), np.ceil(wide / reach_m) + 1) * reach_m
    turns = np.ceil(WITHIN_SIGMAS * sigma[1] / HEADING_STEP_RAD)
    starts = []
    for heading in np.arange(-turns, turns + 1) * HEADING_STEP_RAD:
        placed = turn.mean_m @ rotation(expected[2] + heading).T + expected[:2]
        for x in offsets:
            for y in offsets:
                distance, _ = tree.query(placed + np.array([x, y]), distance_upper_bound=reach_m)
                near = np.minimum(distance, FAR) / (reach_m / 2)
                starts.append((float(np.sum(np.exp(-0.5 * near**2))), x, y, heading))
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
