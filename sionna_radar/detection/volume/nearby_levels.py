"""Levels of the ground's echo from place to place (fields, streets, roofs), learned from pulses sampled over a survey.

In the fit of one pulse's profile a stronger echo of the ground and a nearer one are nearly the same where the echo is
hardly over the volume. What a whole survey says of levels then moves bright ground too near and dark ground too far.
The level at a place is that of the sampled pulses about it, each as far as it is sure of its own, with a weight that
falls with the distance as a Gaussian; the whole survey counts as one more pulse. How far levels reach is what explains
each half of those pulses best from the other half.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.distance import cdist

# Of expectation maximisation.
EM_ROUNDS = 200


@dataclass(frozen=True, kw_only=True, eq=False)
class NearbyLevels:
    """Levels of the ground in pulses sampled over a survey.

    index, place_m: those pulses, and where level ground meets their axes.
    probability: of each level. reach_m: standard deviation of the weights by distance.
    """

    index: Int[np.ndarray, " pulse"]
    place_m: Float[np.ndarray, "pulse 2"]
    probability: Float[np.ndarray, "pulse level"]
    reach_m: float

    def weight(
        self, survey: Float[np.ndarray, " level"], index: Int[np.ndarray, " at"], place_m: Float[np.ndarray, "at 2"]
    ) -> Float[np.ndarray, "at level"]:
        """Return the weights of levels in pulses, from other ones; survey: weights of the whole survey."""
        near = _nearness(place_m, self.place_m, self.reach_m) * (index[:, None] != self.index)
        return _weight(near, self.probability, survey)

    @property
    def together(self) -> float:
        """Median number of the sampled pulses that tell the level of one."""
        return float(np.median(_nearness(self.place_m, self.place_m, self.reach_m).sum(axis=1)))


def nearby_levels(
    likelihood: Float[np.ndarray, "pulse level"],
    survey: Float[np.ndarray, " level"],
    index: Int[np.ndarray, " pulse"],
    place_m: Float[np.ndarray, "pulse 2"],
) -> NearbyLevels | None:
    """Return the levels about sampled pulses; None where those of the whole survey explain them no worse.

    likelihood: of each level in each pulse, up to a factor. survey: weights of levels in the whole survey.
    index, place_m: see `NearbyLevels`.
    """
    farthest_m = float(np.hypot(*np.ptp(place_m, axis=0)))
    nearest_m = farthest_m / np.sqrt(len(place_m))
    halves = np.arange(len(place_m)) % 2 == 0, np.arange(len(place_m)) % 2 == 1
    best = float(np.log(likelihood @ survey).sum()), 0.0
    reach_m = farthest_m / 2
    while reach_m > nearest_m / 2:
        told = 0.0
        for known, other in (halves, halves[::-1]):
            probability = _probability(likelihood[known], survey, place_m[known], reach_m)
            near = _nearness(place_m[other], place_m[known], reach_m)
            told += float(np.log(np.sum(likelihood[other] * _weight(near, probability, survey), axis=1)).sum())
        best = max(best, (told, reach_m))
        reach_m /= 2
    if best[1] == 0.0:
        return None
    probability = _probability(likelihood, survey, place_m, best[1])
    return NearbyLevels(index=index, place_m=place_m, probability=probability, reach_m=best[1])


def _probability(
    likelihood: Float[np.ndarray, "pulse level"],
    survey: Float[np.ndarray, " level"],
    place_m: Float[np.ndarray, "pulse 2"],
    reach_m: float,
) -> Float[np.ndarray, "pulse level"]:
    """Return the probability of each pulse's levels, given its own likelihood and its neighbours'."""
    near = _nearness(place_m, place_m, reach_m)
    np.fill_diagonal(near, 0.0)
    weight = np.broadcast_to(survey, likelihood.shape)
    for _ in range(EM_ROUNDS):
        probability = weight * likelihood
        probability /= probability.sum(axis=1, keepdims=True)
        weight = _weight(near, probability, survey)
    return probability


def _weight(
    near: Float[np.ndarray, "at pulse"],
    probability: Float[np.ndarray, "pulse level"],
    survey: Float[np.ndarray, " level"],
) -> Float[np.ndarray, "at level"]:
    """Return the weights of levels, from the pulses about a place and the whole survey as one more."""
    return np.asarray((survey + near @ probability) / (1 + near.sum(axis=1, keepdims=True)))


def _nearness(
    place_m: Float[np.ndarray, "at 2"], other_m: Float[np.ndarray, "pulse 2"], reach_m: float
) -> Float[np.ndarray, "at pulse"]:
    return np.exp(-0.5 * (cdist(place_m, other_m) / reach_m) ** 2)
