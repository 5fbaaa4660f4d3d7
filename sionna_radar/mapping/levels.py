"""One height for every cell of a map, out of a few levels: smooth where it may be, broken where it must.

Semi-global matching (Hirschmueller 2008, "Stereo Processing by Semiglobal Matching and Mutual Information", IEEE PAMI
30, 328-341): along each of eight directions dynamic programming finds the cost of the best row of heights that ends
at each level of each cell, a change by one level and a jump by any number each at a price; the eight costs are added.
"""

import numpy as np
from jaxtyping import Float32, Int

# Prices in nepers: of neighbours one in three differs by a level, one in twenty by a jump.
CHANGE, JUMP = 1.0, 3.0
# Levels that cost no more than this above the best, along each direction, are as good.
AS_GOOD = 0.5
DIRECTIONS = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))


def choose_levels(cost: Float32[np.ndarray, "row column level"]) -> Int[np.ndarray, "row column"]:
    """Return the level of each cell: of those as good as the best the highest, since nothing hides what lies above.

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
    """Return the cost of the best rows of heights that come from one direction."""
    if down == 0:
        return _along(cost.transpose(1, 0, 2), right, 0).transpose(1, 0, 2)
    result = np.empty_like(cost)
    order = range(len(cost)) if down > 0 else range(len(cost) - 1, -1, -1)
    before: Float32[np.ndarray, "column level"] | None = None
    for row in order:
        if before is None:
            result[row] = cost[row]
        else:
            # A row of heights that comes slantwise starts at the border.
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
    """Return the least cost to come to each level from the cell before, over that cell's least."""
    least = before.min(axis=-1, keepdims=True)
    best = np.minimum(before, least + JUMP)
    best[:, 1:] = np.minimum(best[:, 1:], before[:, :-1] + CHANGE)
    best[:, :-1] = np.minimum(best[:, :-1], before[:, 1:] + CHANGE)
    return best - least
