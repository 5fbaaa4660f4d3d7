"""Random numbers that belong to a pulse, whatever block or worker computes it.

Every stream is a counter-based Philox generator keyed by (seed, stream) whose counter starts at the
pulse index, so a pulse draws the same numbers in a block of one, in a block of a thousand, or alone
(Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3").
"""

from enum import IntEnum

import numpy as np
from jaxtyping import Float, Int


class Stream(IntEnum):
    """Independent uses of randomness within one pulse."""

    DIRECTIONS = 1
    SPECKLE = 2
    NOISE = 3
    TARGETS = 4


def pulse_generator(seed: int, stream: Stream, pulse: int) -> np.random.Generator:
    """Return the generator of one pulse and stream; 2**64 numbers lie between two pulses."""
    return np.random.Generator(np.random.Philox(key=[seed, int(stream)], counter=[0, pulse, 0, 0]))


def pulse_uniforms(
    seed: int, stream: Stream, pulse: Int[np.ndarray, " pulse"], count: int
) -> Float[np.ndarray, "pulse {count}"]:
    """Return `count` numbers in [0, 1) for each pulse."""
    out = np.empty((len(pulse), count))
    for row, index in zip(out, pulse, strict=True):
        pulse_generator(seed, stream, int(index)).random(out=row)
    return out
