"""All states of a drive at once: least squares over what turns say of each other, and how the vehicle moves.

Turns that overlap, neighbours or the ends of a loop, are factors of one kind: their surfaces, compared again at the
states of each iteration, distortion and Doppler included. Factors that a better drive contradicts (a place taken for
another) count by Cauchy's weight on their score, as single pairs do.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import SuperLU, splu

from sionna_radar.studies.slam.motion import Motion
from sionna_radar.studies.slam.registration import QUARTER_TURN, pair_factor
from sionna_radar.studies.slam.surfaces import Surfaces, rotation

ITERATIONS, CONVERGED_M = 6, 0.02


@dataclass(frozen=True, kw_only=True)
class Solved:
    """States of all turns, the scores of the pairs, and the information of all states, factored."""

    states: Float[np.ndarray, "turn 6"]
    scores: Float[np.ndarray, " pair"]
    factored: SuperLU

    @cached_property
    def covariance(self) -> Float[np.ndarray, "turn 6 6"]:
        """Covariance of each state given the pose of the first."""
        covariance = np.empty((len(self.states), 6, 6))
        for turn in range(len(self.states)):
            rows = 6 * turn + np.arange(6)
            units = np.zeros((6 * len(self.states), 6))
            units[rows, np.arange(6)] = 1.0
            covariance[turn] = self.factored.solve(units)[rows]
        return covariance


def solve(
    turns: Sequence[Surfaces],
    twists: Float[np.ndarray, "turn 3"],
    states: Float[np.ndarray, "turn 6"],
    time_s: Float[np.ndarray, " turn"],
    pairs: Sequence[tuple[int, int]],
    motion: Motion,
    *,
    reach_m: float,
    share: float,
    least_score: float,
    anchors: Sequence[tuple[int, int, Float[np.ndarray, " 3"]]] = (),
) -> Solved:
    """Return the states that agree best with all pairs of turns.

    turns: surfaces of each, made with `twists`. pairs: numbers of turns that are compared.
    anchors: turns with the pose of the first in the axes of the second, which draw the drive to where pairs lie on each
        other; only a solution without them counts.
    share: of the information of pairs that is independent; see `slam`. least_score: pairs below it do not count.
    """
    states = states.copy()
    size = 6 * len(states)
    scores = np.zeros(len(pairs))
    for _ in range(ITERATIONS):
        sums = _Sums(size)
        for number, (a, b) in enumerate(pairs):
            factor = pair_factor((turns[a], turns[b]), (states[a], states[b]), (twists[a], twists[b]), reach_m=reach_m)
            scores[number] = 0.0 if factor is None else factor.score
            if factor is not None and factor.score >= least_score:
                sums.add(a, b, share * factor.information, share * factor.gradient)
        for k in range(len(states) - 1):
            sums.add(k, k + 1, *motion.factor(states[k], states[k + 1], float(time_s[k + 1] - time_s[k])))
        for a, b, wanted in anchors:
            sums.add(a, b, *_anchor(states[a], states[b], wanted))
        factored, gradient = splu(sums.information()), sums.gradient
        step = factored.solve(gradient).reshape(-1, 6)
        states -= step
        if np.abs(step[:, :2]).max() < CONVERGED_M:
            break
    return Solved(states=states, scores=scores, factored=factored)


class _Sums:
    """Information and gradient of all factors, gathered."""

    def __init__(self, size: int) -> None:
        self._size = size
        # The first pose is that of the map; its twist is free.
        first = np.arange(3)
        self._rows, self._columns, self._values = [first], [first], [np.full(3, FIXED)]
        self.gradient = np.zeros(size)

    def add(self, a: int, b: int, information: Float[np.ndarray, "12 12"], gradient: Float[np.ndarray, " 12"]) -> None:
        """Add a factor between the states of two turns."""
        index = np.concatenate([6 * a + np.arange(6), 6 * b + np.arange(6)])
        self._rows.append(np.repeat(index, 12))
        self._columns.append(np.tile(index, 12))
        self._values.append(information.ravel())
        self.gradient[index] += gradient

    def information(self) -> csc_matrix:
        """Return the sum of all information."""
        entries = np.concatenate(self._values), (np.concatenate(self._rows), np.concatenate(self._columns))
        return csc_matrix(entries, shape=(self._size, self._size))


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
