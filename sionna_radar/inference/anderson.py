"""Anderson acceleration of fixed-point iterations.

Fisher scoring steps by the expected curvature of the likelihood. Where few echoes decide, as at the end of a swath, the
real curvature is several times the expected one or a fraction of it, and plain steps oscillate about the maximum or
creep. Of all mixtures of the last steps the one is taken whose step would be the shortest if steps were linear in their
starting point (Anderson 1965; Walker and Ni 2011, "Anderson acceleration for fixed-point iterations").
"""

import numpy as np
from jaxtyping import Float

# Number of mixed steps, and the relative threshold of singular values.
DEPTH, MIN_SINGULAR = 4, 1e-10

Vector = Float[np.ndarray, " n"]


class AndersonAcceleration:
    """Anderson acceleration: the next iterate from the last iterates and their proposed steps."""

    def __init__(self) -> None:
        self._past: list[tuple[Vector, Vector, Float[np.ndarray, " seen"]]] = []

    def next(self, place: Vector, step: Vector, seen: Float[np.ndarray, " seen"]) -> Vector:
        """Return the next iterate from a place, by Anderson acceleration of the last steps.

        step, seen: the step proposed there, and what it changes, by which its length is measured.
        """
        proposed = place + step
        if self._past:
            by_seen = np.stack([seen - other for _, _, other in self._past])
            # By eigenvectors: nearly equal steps are nearly linearly dependent.
            value, vector = np.linalg.eigh(by_seen @ by_seen.T)
            kept = value > MIN_SINGULAR * value[-1]
            weight = vector[:, kept] @ ((vector[:, kept].T @ (by_seen @ seen)) / value[kept])
            for factor, (past_place, past_step, _) in zip(weight, self._past, strict=True):
                proposed -= factor * (place + step - past_place - past_step)
        self._past = [*self._past[1 - DEPTH :], (place, step, seen)]
        return proposed
