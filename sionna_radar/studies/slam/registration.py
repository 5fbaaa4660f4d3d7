"""Registration of a turn with small surfaces around it: pose and motion of the vehicle, with their uncertainty.

The residual of a surface of the turn, moved by the pose, and the nearest one of the map is the difference e of their
means, of the covariance S = S_turn + S_map: along a wall it counts little, across it much (Stoyanov et al. 2012,
International Journal of Robotics Research 31, 1377). What moves, or is seen from one side only, has a large e: pairs
count by Cauchy's weight 1 / (1 + e' S^-1 e / 2). The state is pose and twist in the middle of the turn; the twist
enters by the distortion of the turn and by Doppler.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from sionna_radar.studies.slam.surfaces import Surfaces, rotation

ITERATIONS, CONVERGED = 12, 1e-4


@dataclass(frozen=True, kw_only=True)
class Prior:
    """A Gaussian of a state: pose (two places in m, heading in rad) and twist (m/s, m/s, rad/s)."""

    mean: Float[np.ndarray, " 6"]
    information: Float[np.ndarray, "6 6"]


@dataclass(frozen=True, kw_only=True)
class Registered:
    """A state, and how well the turn lies on the map.

    matched: share of the turn's surfaces with a partner; fit: mean weight of the pairs, 1 for a perfect one.
    seen: information of the pairs alone, without the prior.
    """

    state: Float[np.ndarray, " 6"]
    seen: Float[np.ndarray, "6 6"]
    matched: float
    fit: float

    @property
    def score(self) -> float:
        """Share of the turn that lies on the map."""
        return self.matched * self.fit


def register(
    turn: Surfaces,
    around: Surfaces,
    prior: Prior,
    *,
    reach_m: float,
    twist: Float[np.ndarray, " 3"],
    start: Float[np.ndarray, " 6"] | None = None,
) -> Registered:
    """Return the state in which a turn's surfaces lie on those around it.

    turn: in the axes of the vehicle, as its peaks lie with `twist`; around: on the map.
    reach_m: farthest partner.
    """
    tree = cKDTree(around.mean_m)
    state = (prior.mean if start is None else start).copy()
    seen, weights, near = np.zeros((6, 6)), np.zeros(0), np.zeros(len(turn), dtype=bool)
    for _ in range(ITERATIONS):
        R = rotation(state[2])
        local = turn.mean_m + turn.slope @ (state[3:] - twist)
        moved = local @ R.T + state[:2]
        distance, partner = tree.query(moved, distance_upper_bound=reach_m)
        near = np.isfinite(distance)
        if near.sum() < MIN_PAIRS:
            break
        e = moved[near] - around.mean_m[partner[near]]
        S = R @ turn.covariance_m2[near] @ R.T + around.cut_m2[partner[near]]
        W = np.linalg.inv(S)
        chi2 = np.einsum("ni,nij,nj->n", e, W, e)
        weights = 1 / (1 + chi2 / 2)
        J = np.empty((len(e), 2, 6))
        J[:, :, :2] = np.eye(2)
        J[:, :, 2] = (local[near] @ QUARTER_TURN) @ R.T
        J[:, :, 3:] = R @ turn.slope[near]
        WJ = W @ J * weights[:, None, None]
        seen = np.einsum("nij,nik->jk", J, WJ)
        gradient = np.einsum("nij,ni->j", WJ, e) + prior.information @ difference(state, prior.mean)
        step = np.linalg.solve(seen + prior.information, gradient)
        state = state - step
        if np.abs(step).max() < CONVERGED:
            break
    return Registered(
        state=state,
        seen=seen,
        matched=float(near.mean()) if len(near) else 0.0,
        fit=float(weights.mean()) if len(weights) else 0.0,
    )


MIN_PAIRS = 6


@dataclass(frozen=True, kw_only=True)
class PairFactor:
    """What two turns say of each other's states, near them: half the squared residuals, to second order.

    information: with respect to the states of the first and the second turn. scores: derivatives of each residual's
    half square; place_m: on the map, of each. score: as of `Registered`.
    """

    information: Float[np.ndarray, "12 12"]
    scores: Float[np.ndarray, "residual 12"]
    place_m: Float[np.ndarray, "residual 2"]
    score: float

    @property
    def gradient(self) -> Float[np.ndarray, " 12"]:
        """Sum of the scores."""
        return self.scores.sum(axis=0)


def pair_factor(
    turns: tuple[Surfaces, Surfaces],
    states: tuple[Float[np.ndarray, " 6"], Float[np.ndarray, " 6"]],
    twists: tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]],
    *,
    reach_m: float,
) -> PairFactor | None:
    """Return the factor of a pose graph between two turns; None if too few of their surfaces lie on each other.

    twists: with which the surfaces of each were made.
    """
    moved, slope, spread = list[np.ndarray](), list[np.ndarray](), list[np.ndarray]()
    for turn, state, twist in zip(turns, states, twists, strict=True):
        R = rotation(state[2])
        local = turn.mean_m + turn.slope @ (state[3:] - twist)
        J = np.empty((len(turn), 2, 6))
        J[:, :, :2] = np.eye(2)
        J[:, :, 2] = (local @ QUARTER_TURN) @ R.T
        J[:, :, 3:] = R @ turn.slope
        moved.append(local @ R.T + state[:2])
        slope.append(J)
        # Along a wall the second turn tells nothing.
        spread.append(R @ (turn.covariance_m2 if len(spread) == 0 else turn.cut_m2) @ R.T)
    if min(len(turn) for turn in turns) < MIN_PAIRS:
        return None
    distance, partner = cKDTree(moved[1]).query(moved[0], distance_upper_bound=reach_m)
    near = np.isfinite(distance)
    if near.sum() < MIN_PAIRS:
        return None
    partner = partner[near]
    e = moved[0][near] - moved[1][partner]
    W = np.linalg.inv(spread[0][near] + spread[1][partner])
    weight = 1 / (1 + np.einsum("ni,nij,nj->n", e, W, e) / 2)
    J = np.concatenate([slope[0][near], -slope[1][partner]], axis=2)
    WJ = W @ J * weight[:, None, None]
    return PairFactor(
        information=np.einsum("nij,nik->jk", J, WJ),
        scores=np.einsum("nij,ni->nj", WJ, e),
        place_m=moved[0][near],
        score=float(near.mean() * weight.mean()),
    )


# Takes the derivative of a rotation: R'(a) p = R(a) (p @ QUARTER_TURN).
QUARTER_TURN = np.array([[0.0, 1.0], [-1.0, 0.0]])


def difference(state: Float[np.ndarray, " k"], other: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """Return the difference of two states, headings within half a turn."""
    away = state - other
    away[2] = np.mod(away[2] + np.pi, 2 * np.pi) - np.pi
    return away


def predicted(state: Float[np.ndarray, " 6"], time_s: float) -> Float[np.ndarray, " 6"]:
    """Return the state after a time at the same twist."""
    ahead, right, yaw = state[3:]
    turned = yaw * time_s
    half = turned / 2
    chord = np.sinc(half / np.pi) * time_s * np.array([ahead, right])
    return np.concatenate([state[:2] + rotation(state[2] + half) @ chord, [state[2] + turned], state[3:]])
