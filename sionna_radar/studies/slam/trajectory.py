"""All states of a drive at once: least squares over what turns say of each other, and how the vehicle moves.

Turns that overlap, neighbours or the ends of a loop, are factors of one kind: their surfaces, compared again at the
states of each iteration, distortion and Doppler included. Factors that a better drive contradicts (a place taken for
another) count by Cauchy's weight on their score, as single pairs do.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import SuperLU, splu

from sionna_radar.studies.slam.covariance import Factor, rows_of, state_covariance
from sionna_radar.studies.slam.motion import Motion
from sionna_radar.studies.slam.odometry import ODOMETER_SIGMA, Increments
from sionna_radar.studies.slam.registration import QUARTER_TURN, pair_factor
from sionna_radar.studies.slam.surfaces import Surfaces, rotation

ITERATIONS, CONVERGED_M = 6, 0.02


@dataclass(frozen=True, kw_only=True)
class Solved:
    """States of all turns, the scores of the pairs, and all information.

    odometer: scale and yaw bias of the odometry, rad/s. factored: all information; known: of it, what is not of pairs.
    factors: of the pairs that count. share, view_m: as of `solve`.
    """

    states: Float[np.ndarray, "turn 6"]
    odometer: Float[np.ndarray, " 2"]
    scores: Float[np.ndarray, " pair"]
    factored: SuperLU
    known: csc_matrix
    factors: Sequence[Factor]
    share: float
    view_m: float

    @cached_property
    def covariance(self) -> Float[np.ndarray, "turn 3 3"]:
        """Covariance of each pose given the first."""
        return state_covariance(
            self.factored, self.known, self.states, self.factors, share=self.share, view_m=self.view_m
        )


def solve(
    turns: Sequence[Surfaces],
    twists: Float[np.ndarray, "turn 3"],
    states: Float[np.ndarray, "turn 6"],
    time_s: Float[np.ndarray, " turn"],
    pairs: Sequence[tuple[int, int]],
    motion: Motion,
    odometry: Increments | None,
    *,
    reach_m: float,
    view_m: float,
    share: float,
    least_score: float,
    anchors: Sequence[tuple[int, int, Float[np.ndarray, " 3"]]] = (),
) -> Solved:
    """Return the states that agree best with all pairs of turns.

    turns: surfaces of each, made with `twists`. pairs: numbers of turns that are compared.
    anchors: turns with the pose of the first in the axes of the second, which draw the drive to where pairs lie on each
        other; only a solution without them counts.
    view_m: way over which the same is in view.
    share: weight of pairs against the motion. least_score: pairs below it do not count.
    """
    states, odometer = states.copy(), np.zeros(2)
    size = states.size + len(odometer)
    extra = np.arange(states.size, size)
    scores = np.zeros(len(pairs))
    for _ in range(ITERATIONS):
        seen, known, factors = _Sums(size), _Sums(size), list[Factor]()
        for number, (a, b) in enumerate(pairs):
            factor = pair_factor((turns[a], turns[b]), (states[a], states[b]), (twists[a], twists[b]), reach_m=reach_m)
            scores[number] = 0.0 if factor is None else factor.score
            if factor is not None and factor.score >= least_score:
                seen.add(rows_of(a, b), share * factor.information, share * factor.gradient)
                factors.append((a, b, factor))
        # The first pose is that of the map; its twist is free.
        known.add(np.arange(3), FIXED * np.eye(3), np.zeros(3))
        known.add(extra, np.diag(ODOMETER_SIGMA**-2), odometer * ODOMETER_SIGMA**-2)
        for k in range(len(states) - 1):
            two = states[k], states[k + 1]
            known.add(rows_of(k, k + 1), *motion.factor(*two, float(time_s[k + 1] - time_s[k])))
            if odometry is not None:
                known.add(np.append(rows_of(k, k + 1), extra), *odometry.factor(k, *two, odometer))
        for a, b, wanted in anchors:
            known.add(rows_of(a, b), *_anchor(states[a], states[b], wanted))
        outside = known.information()
        factored = splu((seen.information() + outside).tocsc())
        step = factored.solve(seen.gradient + known.gradient)
        odometer -= step[states.size :]
        states -= step[: states.size].reshape(-1, 6)
        if np.abs(step[: states.size].reshape(-1, 6)[:, :2]).max() < CONVERGED_M:
            break
    return Solved(
        states=states,
        odometer=odometer,
        scores=scores,
        factored=factored,
        known=outside,
        factors=factors,
        share=share,
        view_m=view_m,
    )


class _Sums:
    """Information and gradient of several factors, gathered."""

    def __init__(self, size: int) -> None:
        self._rows, self._columns, self._values = list[Any](), list[Any](), list[Any]()
        self.gradient = np.zeros(size)

    def add(
        self, rows: Int[np.ndarray, " n"], information: Float[np.ndarray, "n n"], gradient: Float[np.ndarray, " n"]
    ) -> None:
        """Add a factor between some states."""
        self._rows.append(np.repeat(rows, len(rows)))
        self._columns.append(np.tile(rows, len(rows)))
        self._values.append(information.ravel())
        self.gradient[rows] += gradient

    def information(self) -> csc_matrix:
        """Return the sum of all information."""
        if not self._values:
            return csc_matrix((len(self.gradient),) * 2)
        entries = np.concatenate(self._values), (np.concatenate(self._rows), np.concatenate(self._columns))
        return csc_matrix(entries, shape=(len(self.gradient),) * 2)


def _anchor(
    later: Float[np.ndarray, " 6"], earlier: Float[np.ndarray, " 6"], wanted: Float[np.ndarray, " 3"]
) -> tuple[Float[np.ndarray, "12 12"], Float[np.ndarray, " 12"]]:
    R = rotation(earlier[2])
    away = R.T @ (later[:2] - earlier[:2])
    e = np.array([*away, later[2] - earlier[2]]) - wanted
    e[2] = np.mod(e[2] + np.pi, 2 * np.pi) - np.pi
    J = np.zeros((3, 12))
    J[:2, :2], J[:2, 6:8], J[2, 2], J[2, 8] = R.T, -R.T, 1.0, -1.0
    J[:2, 8] = -(QUARTER_TURN.T @ away)
    W = np.diag(ANCHORED)
    return J.T @ W @ J, J.T @ W @ e


# Information of an anchor: half a metre and a degree.
ANCHORED = np.array([4.0, 4.0, float(np.deg2rad(1.0)) ** -2])
# Information on the first pose, so large that it does not move.
FIXED = 1e9
