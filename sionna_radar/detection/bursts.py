"""Taking bursts of other radars out of beat signals.

The beat of ground is the sum of many echoes and noise: its samples are Gaussian, of a width that the median tells even
where a part of them is something else. Samples that hardly any Gaussian one would exceed belong to a burst. They are
set to zero (zeroing: Fischer 2016, "Untersuchungen zum Interferenzverhalten automobiler Radarsensorik"), and the rest
is raised by the share that was lost, so that echoes keep their power.
"""

import numpy as np
from jaxtyping import Bool, Inexact

# Share of the samples of a pure Gaussian signal that are taken for bursts.
FALSE_BURSTS = 1e-6
# Samples on either side of one that goes that go as well: a burst does not end where it falls under the threshold.
BESIDE = 2


def zeroed(beat: Inexact[np.ndarray, "pulse sample"]) -> Inexact[np.ndarray, "pulse sample"]:
    """Return beat signals without bursts; a signal that is nothing else is left as it is."""
    burst = bursts(beat)
    kept = 1 - burst.mean(axis=1, keepdims=True)
    burst &= kept > 0.5
    out: Inexact[np.ndarray, "pulse sample"] = np.where(burst, 0, beat) / np.where(kept > 0.5, kept, 1.0)
    return out


def bursts(beat: Inexact[np.ndarray, "pulse sample"]) -> Bool[np.ndarray, "pulse sample"]:
    """Return which samples are those of bursts."""
    # Of a real Gaussian of unit width the median size is 0.674 and one in a million lies beyond 4.89; of a complex one,
    # whose power is exponential, sqrt(ln 2) and sqrt(-ln p) in units of the root mean square.
    ratio = np.sqrt(-np.log(FALSE_BURSTS) / np.log(2)) if np.iscomplexobj(beat) else 4.8916 / 0.67449
    size = np.abs(beat)
    width = np.median(size, axis=1, keepdims=True)
    # A converter so coarse that it makes zeros of half of the samples leaves no width to tell bursts by.
    beyond = (size > ratio * width) & (width > 0)
    found = beyond.copy()
    for step in range(1, BESIDE + 1):
        found[:, step:] |= beyond[:, :-step]
        found[:, :-step] |= beyond[:, step:]
    return found
