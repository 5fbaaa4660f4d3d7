"""Covariances between many places, as machine code."""

from typing import no_type_check

import numpy as np

from sionna_radar.foundation.compiled import compiled


@compiled
@no_type_check
def entry_of(distance, step, last):
    """Return the entry of a `CovarianceTable` below a distance, and how far it is toward the next."""
    k = min(int(np.sqrt(distance / step)), last - 1)
    return k, min(max((distance / step - k * k) / (2 * k + 1), 0.0), 1.0)


@compiled
@no_type_check
def look_up(distance, step, value, result):
    """Write the covariance at distances."""
    for n in range(len(distance)):
        k, share = entry_of(distance[n], step, len(value) - 1)
        result[n] = value[k] + share * (value[k + 1] - value[k])


@compiled
@no_type_check
def between(one, other, step, value, result):
    """Write the covariance between places."""
    for i in range(len(one)):
        for j in range(len(other)):
            x, y = one[i, 0] - other[j, 0], one[i, 1] - other[j, 1]
            k, share = entry_of(np.sqrt(x * x + y * y), step, len(value) - 1)
            result[i, j] = value[k] + share * (value[k + 1] - value[k])


@compiled
@no_type_check
def pairs(place, step, last, entry, share):
    """Write the entry below the distance of each two of some places, row by row of the lower triangle."""
    n = 0
    for i in range(len(place)):
        for j in range(i + 1):
            x, y = place[i, 0] - place[j, 0], place[i, 1] - place[j, 1]
            entry[n], share[n] = entry_of(np.sqrt(x * x + y * y), step, last)
            n += 1


@compiled
@no_type_check
def fill(value, entry, share, noise, factor, jitter, total):
    """Write the lower triangle of the covariance of measured heights: of the terrain, and of the noise."""
    n = 0
    for i in range(len(total)):
        for j in range(i + 1):
            k = entry[n]
            total[i, j] = value[k] + share[n] * (value[k + 1] - value[k]) + factor * noise[n]
            n += 1
        total[i, i] += jitter


@compiled
@no_type_check
def sensitivity(inverse, solved, entry, share, noise, by_entry):
    """Write by how much the loss grows with each entry of the table, and return by how much with the noise's factor.

    inverse: of the measured heights' covariance, its lower triangle; solved: times the heights. The loss grows with
    the covariance by half of (inverse - solved solved^T).
    """
    by_entry[:] = 0.0
    by_noise, n = 0.0, 0
    for i in range(len(solved)):
        for j in range(i + 1):
            # The upper triangle holds the same off the diagonal.
            outward = (inverse[i, j] - solved[i] * solved[j]) * (0.5 if i == j else 1.0)
            k = entry[n]
            by_entry[k] += outward * (1.0 - share[n])
            by_entry[k + 1] += outward * share[n]
            by_noise += outward * noise[n]
            n += 1
    return by_noise
