"""The least work that a back-projection is, as machine code."""

import math
from typing import no_type_check

from sionna_radar.foundation.compiled import compiled
from sionna_radar.foundation.turns import turned


@compiled
@no_type_check
def nearest_samples(low, high, pixel, apex, spectra, bins_per_m, cycles_per_m, reach, ahead, image):
    """Add to each pixel from low to high the nearest sample of all pulses that light it, turned by its phase.

    pixel, apex: positions in metres; spectra: by pulse and bin; ahead: the direction along the track.
    bins_per_m, cycles_per_m: of a spectrum, and of its phase, for each metre of range; reach: greatest direction cosine
        along the track of a pixel that is lit.
    """
    for n in range(low, high):
        real = imaginary = 0.0
        for k in range(len(apex)):
            x, y, z = pixel[n, 0] - apex[k, 0], pixel[n, 1] - apex[k, 1], pixel[n, 2] - apex[k, 2]
            range_m = math.sqrt(x * x + y * y + z * z)
            if abs(x * ahead[0] + y * ahead[1] + z * ahead[2]) > reach * range_m:
                continue
            c, s = turned(cycles_per_m * range_m)
            value = spectra[k, int(range_m * bins_per_m)]
            real += value.real * c - value.imag * s
            imaginary += value.real * s + value.imag * c
        image[n] = complex(real, imaginary)
