"""Noise levels of CFARs of means, as machine code; see `cfar`."""

from typing import no_type_check

import numpy as np

from sionna_radar.foundation.compiled import compiled

CELL_AVERAGING, GREATEST_OF, SMALLEST_OF = 0, 1, 2


@compiled
@no_type_check
def mean_levels(low, high, power, kind, guard, training, stride, level):
    """Write the noise level at each bin of some spectra, infinite where the training cells of neither side fit.

    stride: bins in a range cell; the training cells of a bin are whole cells away from it.
    """
    bins = power.shape[1]
    cells, reach = -(-bins // stride), (guard + training) * stride
    # Sums over range cells, one for each bin within the cell.
    running = np.zeros((cells + 1) * stride)
    for row in range(low, high):
        for k in range(cells * stride):
            running[k + stride] = running[k] + (power[row, k] if k < bins else 0.0)
        for b in range(bins):
            lag = lead = 0.0
            below, above = b >= reach, b + reach < bins
            if below:
                to = b - guard * stride
                lag = max((running[to] - running[to - training * stride]) / training, 0.0)
            if above:
                start = b + (guard + 1) * stride
                lead = max((running[start + training * stride] - running[start]) / training, 0.0)
            if not below or not above:
                level[row, b] = lag if below else lead if above else np.inf
            elif kind == CELL_AVERAGING:
                level[row, b] = (lag + lead) / 2
            else:
                level[row, b] = max(lag, lead) if kind == GREATEST_OF else min(lag, lead)
