"""One height for every cell of a map, out of a few levels: smooth where possible, broken where necessary.

Semi-global matching (Hirschmueller 2008, "Stereo Processing by Semiglobal Matching and Mutual Information", IEEE PAMI
30, 328-341): along each of eight directions dynamic programming finds the cost of the best path of heights that ends
at each level of each cell, with one penalty for a change by one level and one for any jump; the eight costs are added.
"""

import numpy as np
from jaxtyping import Float32, Int

# Penalties in nepers: one in three neighbours differs by a level, one in twenty by a jump.
CHANGE, JUMP = 1.0, 3.0
# Levels whose cost exceeds the best by no more than this, along each direction, are as good.
AS_GOOD = 0.5
DIRECTIONS = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))


def choose_levels(cost: Float32[np.ndarray, "row column level"]) -> Int[np.ndarray, "row column"]:
    """Return the level of each cell: the highest of those as good as the best, since nothing occludes it from above.

    Parameters
    ----------
    cost:
        Evidence against each level of each cell, in nepers.

    """
    from sionna_radar.mapping.level_kernels import add_paths

    total, cost = np.zeros_like(cost), np.ascontiguousarray(cost)
    for down, right in DIRECTIONS:
        add_paths(cost, down, right, CHANGE, JUMP, total)
    good = total <= total.min(axis=-1, keepdims=True) + AS_GOOD * len(DIRECTIONS)
    highest: Int[np.ndarray, "row column"] = cost.shape[-1] - 1 - np.argmax(good[..., ::-1], axis=-1)
    return highest
