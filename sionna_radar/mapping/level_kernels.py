"""Dynamic programming along the directions of a map as machine code; see `levels`."""

from typing import no_type_check

import numpy as np

from sionna_radar.foundation.compiled import compiled


@compiled
@no_type_check
def add_paths(cost, down, right, change, jump, total):
    """Add the cost of the best paths of heights from one direction: (row, column, level)."""
    rows, columns, levels = cost.shape
    before, here = np.empty((columns, levels), dtype=np.float32), np.empty((columns, levels), dtype=np.float32)
    change, jump = np.float32(change), np.float32(jump)
    for i in range(rows):
        row = i if down >= 0 else rows - 1 - i
        for j in range(columns):
            column = j if right >= 0 else columns - 1 - j
            source = column - right
            # A path starts at the border.
            if not 0 <= source < columns or (down != 0 and i == 0):
                for k in range(levels):
                    here[column, k] = cost[row, column, k]
            else:
                past = here[source] if down == 0 else before[source]
                least = past[0]
                for k in range(levels):
                    least = min(least, past[k])
                for k in range(levels):
                    best = min(past[k], least + jump)
                    if k > 0:
                        best = min(best, past[k - 1] + change)
                    if k < levels - 1:
                        best = min(best, past[k + 1] + change)
                    here[column, k] = cost[row, column, k] + (best - least)
            for k in range(levels):
                total[row, column, k] += here[column, k]
        before, here = here, before
