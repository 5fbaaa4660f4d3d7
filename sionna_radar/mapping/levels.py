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
    total = np.zeros_like(cost)
    for down, right in DIRECTIONS:
        total += _along(cost, down, right)
    good = total <= total.min(axis=-1, keepdims=True) + AS_GOOD * len(DIRECTIONS)
    highest: Int[np.ndarray, "row column"] = cost.shape[-1] - 1 - np.argmax(good[..., ::-1], axis=-1)
    return highest


def _along(
    cost: Float32[np.ndarray, "row column level"], down: int, right: int
) -> Float32[np.ndarray, "row column level"]:
    """Return the cost of the best paths of heights from one direction."""
    if down == 0:
        return _along(cost.transpose(1, 0, 2), right, 0).transpose(1, 0, 2)
    result = np.empty_like(cost)
    order = range(len(cost)) if down > 0 else range(len(cost) - 1, -1, -1)
    before: Float32[np.ndarray, "column level"] | None = None
    for row in order:
        if before is None:
            result[row] = cost[row]
        else:
            # A diagonal path starts at the border.
            shifted = np.zeros_like(before)
            to, source = _shifted(right)
            shifted[to] = before[source]
            result[row] = cost[row] + _cheapest(shifted)
        before = result[row]
    return result


def _shifted(right: int) -> tuple[slice, slice]:
    if right == 0:
        return slice(None), slice(None)
    return (slice(1, None), slice(None, -1)) if right > 0 else (slice(None, -1), slice(1, None))


def _cheapest(before: Float32[np.ndarray, "column level"]) -> Float32[np.ndarray, "column level"]:
    """Return the least cost of reaching each level from the previous cell, relative to that cell's minimum."""
    least = before.min(axis=-1, keepdims=True)
    best = np.minimum(before, least + JUMP)
    best[:, 1:] = np.minimum(best[:, 1:], before[:, :-1] + CHANGE)
    best[:, :-1] = np.minimum(best[:, :-1], before[:, 1:] + CHANGE)
    return best - least
