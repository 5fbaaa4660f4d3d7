"""Iterations brought to rest: Anderson's mixing of the last steps.

Fisher scoring steps by the expected curvature of the likelihood. Where few echoes decide, as at the end of a swath, the
real curvature is several times the expected one or a fraction of it, and plain steps swing about the maximum or creep.
The last steps tell by how much: of all mixtures of them the one is taken whose step, were steps linear in where they
begin, would be the shortest (Anderson 1965; Walker and Ni 2011, "Anderson acceleration for fixed-point iterations").
"""

import numpy as np
from jaxtyping import Float

# Steps that are mixed, and the part of the largest below which singular values count as none.
DEPTH, LEAST_SINGULAR = 4, 1e-10

Vector = Float[np.ndarray, " n"]


class Mixing:
    """The next place of an iteration, from the last ones and the steps that were proposed there."""

    def __init__(self) -> None:
        self._past: list[tuple[Vector, Vector, Float[np.ndarray, " seen"]]] = []

    def next(self, place: Vector, step: Vector, seen: Float[np.ndarray, " seen"]) -> Vector:
        """Return where to go on from a place.

        step, seen: the step proposed there, and what it changes, by which its length is measured.
        """
        proposed = place + step
        if self._past:
            by_seen = np.stack([seen - other for _, _, other in self._past])
            # By eigenvectors: of nearly equal steps, none tells much more than the other.
            value, vector = np.linalg.eigh(by_seen @ by_seen.T)
            kept = value > LEAST_SINGULAR * value[-1]
            share = vector[:, kept] @ ((vector[:, kept].T @ (by_seen @ seen)) / value[kept])
            for part, (past_place, past_step, _) in zip(share, self._past, strict=True):
                proposed -= part * (place + step - past_place - past_step)
        self._past = [*self._past[1 - DEPTH :], (place, step, seen)]
        return proposed
