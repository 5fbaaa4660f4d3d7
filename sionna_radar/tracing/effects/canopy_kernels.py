"""Following rays through vegetation, as machine code."""

from typing import no_type_check

import numpy as np

from sionna_radar.foundation.compiled import compiled


@compiled
@no_type_check
def follow(hit, back, least, steps, first, spacing, stand, top, extinction, backscatter, drawn, out):
    """Write, for rays that end at the ground, what plants along them pass and return.

    hit: where each ends; back: unit vectors from there to the radar; least: ranges from the ground that need no look.
    steps: so many equal steps are taken within each of these ranges; first, spacing: of the grid's cells.
    stand, top: the number of the stand in each cell, and its top; extinction, backscatter: of each stand.
    drawn: two numbers in [0, 1) for each ray.
    out: of each ray the share of power that passes, both ways; the integral of backscatter times what passes to there
        and back; and how far from the ground the place is that was drawn with that as its weight.
    """
    rows, columns = stand.shape
    west, south = first
    passed, returned, away = out
    weight = np.empty(steps)
    for ray in range(len(hit)):
        step = least[ray] / steps
        depth = 0.0
        total = 0.0
        # From the radar's end of the range to the ground.
        for k in range(steps - 1, -1, -1):
            s = (k + 0.5) * step
            x = hit[ray, 0] + s * back[ray, 0]
            y = hit[ray, 1] + s * back[ray, 1]
            column = int(np.floor((x - west) / spacing + 0.5))
            row = int(np.floor((y - south) / spacing + 0.5))
            weight[k] = 0.0
            if row < 0 or column < 0 or row >= rows or column >= columns:
                continue
            own = stand[row, column]
            if own < 0 or hit[ray, 2] + s * back[ray, 2] >= top[row, column]:
                continue
            loss = 2.0 * extinction[own] * step
            # Within the step the share falls exponentially, too.
            mean = (1.0 - np.exp(-loss)) / loss if loss > 1e-9 else 1.0
            weight[k] = backscatter[own] * step * np.exp(-depth) * mean
            total += weight[k]
            depth += loss
        passed[ray] = np.exp(-depth)
        returned[ray] = total
        away[ray] = 0.0
        if total > 0.0:
            wanted = drawn[ray, 0] * total
            for k in range(steps - 1, -1, -1):
                wanted -= weight[k]
                if wanted <= 0.0 and weight[k] > 0.0:
                    away[ray] = (k + drawn[ray, 1]) * step
                    break
