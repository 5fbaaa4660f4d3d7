"""The area that a Pareto front covers, which several tests of designs compare."""

import numpy as np
from jaxtyping import Float

from sionna_radar.studies.design.surrogate import pareto


def hypervolume(points: Float[np.ndarray, "n 2"], corner: Float[np.ndarray, "2"]) -> float:
    """Return the area between the front of some points and a corner; both objectives are minimised."""
    front = pareto(points[(points < corner).all(axis=1)])
    edges = np.r_[front[:, 0], corner[0]]
    return float(np.sum(np.diff(edges) * (corner[1] - front[:, 1])))
