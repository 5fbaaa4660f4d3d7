"""Covariance of all states: the scatter of their scores, and what a drive cannot know of its own systematic error.

The inverse of the information holds for independent errors. Successive turns look at the same walls, and err alike.
With g_c the score of all residuals on the same ground, C the information of motion and odometry and H that of all, the
covariance is H^-1 (sum g_c g_c' + C + sum b_j b_j') H^-1: a sandwich of clusters (Liang and Zeger 1986, Biometrika 73,
13), which needs no model of their correlation.

No residual shows what all walls in view have in common: a drive that is everywhere 0.2 % short fits its images. Such
errors are considered, not solved for (Schmidt 1966, in Advances in Control Systems 3, 293): each pair of turns errs in
its distance by a factor and in its heading by an angle per metre. Half of their variance stays for the whole drive (the
radar, the method), half as long as the same is in view. b_j is the score that one standard deviation of the j-th makes.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csc_matrix, hstack
from scipy.sparse.linalg import SuperLU

from sionna_radar.studies.slam.motion import travelled_m
from sionna_radar.studies.slam.registration import PairFactor

# Side of the ground whose residuals are one cluster; with 7 to 28 m sigma is the same within a sixth.
CLUSTER_M = 28.0
# Standard deviations of the two systematic errors, by maximum likelihood over parts of 50 to 400 m of two drives
# (stadium and Florence): of the scale, and of the heading per way, rad/m. That they are split in halves is assumed.
SCALE_SIGMA, YAW_SIGMA_RAD_M = 0.0019, 1.3e-4
# Turns whose covariances are solved for at once, which bounds the memory.
AT_ONCE = 100

Factor = tuple[int, int, PairFactor]


def state_covariance(
    factored: SuperLU,
    known: csc_matrix,
    states: Float[np.ndarray, "turn 6"],
    factors: Sequence[Factor],
    *,
    share: float,
    view_m: float,
) -> Float[np.ndarray, "turn 3 3"]:
    """Return the covariance of each pose given the first.

    factored: all information. known: of it, what is not of pairs: motion and odometry. factors: pairs of turns that
    count, with what they say. share: weight of them in `factored`. view_m: way over which the same is in view.
    """
    size = known.shape[0]
    scores = share * hstack([_cluster_scores(factors, size), _systematic_scores(factors, states, view_m, size)]).tocsc()
    covariance = np.empty((len(states), 3, 3))
    for first in range(0, len(states), AT_ONCE):
        turns = np.arange(first, min(first + AT_ONCE, len(states)))
        rows = (6 * turns[:, None] + np.arange(3)).ravel()
        units = np.zeros((size, len(rows)))
        units[rows, np.arange(len(rows))] = 1.0
        solved = factored.solve(units)
        errors, right = scores.T @ solved, known @ solved
        for turn in turns:
            pose = slice(3 * (turn - first), 3 * (turn - first) + 3)
            covariance[turn] = errors[:, pose].T @ errors[:, pose] + solved[:, pose].T @ right[:, pose]
    return covariance


def _cluster_scores(factors: Sequence[Factor], size: int) -> csc_matrix:
    """Return the scores of the residuals on each square of ground, a column each."""
    square = np.concatenate([np.floor(factor.place_m / CLUSTER_M).astype(np.int64) for _, _, factor in factors])
    _, column = np.unique(square, axis=0, return_inverse=True)
    rows = np.concatenate([np.tile(rows_of(a, b), (len(factor.place_m), 1)) for a, b, factor in factors])
    scores = np.concatenate([factor.scores for _, _, factor in factors])
    return csc_matrix((scores.ravel(), (rows.ravel(), np.repeat(column.ravel(), 12))), shape=(size, column.max() + 1))


def _systematic_scores(
    factors: Sequence[Factor], states: Float[np.ndarray, "turn 6"], view_m: float, size: int
) -> csc_matrix:
    """Return the scores of the systematic errors: of scale and heading, all along the way and in each part of it."""
    way_m = travelled_m(states)
    part = 1 + (way_m / view_m).astype(np.int64)
    scores = np.zeros((size, 1 + part[-1], 2))
    for a, b, factor in factors:
        between = states[a, :2] - states[b, :2]
        scale = SCALE_SIGMA * factor.information[:, :2] @ between
        yaw = YAW_SIGMA_RAD_M * factor.information[:, 2] * np.hypot(*between)
        for column in (0, part[b]):
            scores[rows_of(a, b), column] += np.column_stack([scale, yaw]) * np.sqrt(0.5)
    return csc_matrix(scores.reshape(size, -1))


def rows_of(a: int, b: int) -> Int[np.ndarray, " 12"]:
    """Return the rows of the states of two turns."""
    return np.concatenate([6 * a + np.arange(6), 6 * b + np.arange(6)])
