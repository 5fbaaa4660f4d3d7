"""Bodies of targets: shapes in axes of their own, to the right, forward and up."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int


# Known by identity: arrays have no hash.
@dataclass(frozen=True, kw_only=True, eq=False)
class Body:
    """Triangles, each so small that a wave is plane over it.

    vertices_m: right, forward and up.
    faces: counter-clockwise seen from outside. two_sided: those of sheets, which have two outsides.
    reflectivity: of its surface, power over that of a perfect conductor.
    """

    vertices_m: Float[np.ndarray, "vertex 3"]
    faces: Int[np.ndarray, "face 3"]
    two_sided: Bool[np.ndarray, " face"]
    reflectivity: float = 1.0
