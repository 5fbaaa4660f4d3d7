"""A covariance of heights by linear interpolation in a table, dense near zero: all that is asked of it by thousands.

The table is linear in the square root of the distance, so that an entry is found without a search.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class CovarianceTable:
    """Covariances at the distances 0, step, 4 step, 9 step and so on, which they do not exceed."""

    step_m: float
    value_m2: Float[np.ndarray, " entry"]

    @staticmethod
    def distances(farthest_m: float, entries: int) -> Float[np.ndarray, " {entries}"]:
        """Return the distances of the entries of a table that reaches to the farthest."""
        return np.linspace(0.0, np.sqrt(farthest_m), entries) ** 2

    def at(self, distance_m: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Return the covariance at distances."""
        from sionna_radar.mapping.covariance_kernels import look_up

        result = np.empty(distance_m.shape)
        look_up(np.ascontiguousarray(distance_m).ravel(), self.step_m, self.value_m2, result.reshape(-1))
        return result

    def between(self, one_m: Float[np.ndarray, "n 2"], other_m: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, "n m"]:
        """Return the covariance between places."""
        from sionna_radar.mapping.covariance_kernels import between

        result = np.empty((len(one_m), len(other_m)))
        between(*(np.ascontiguousarray(place) for place in (one_m, other_m)), self.step_m, self.value_m2, result)
        return result
