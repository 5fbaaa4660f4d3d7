"""Drop size distributions of rain."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from sionna_radar.weather.validity import ValidityError


@dataclass(frozen=True, kw_only=True)
class ExponentialDrops:
    """Drops whose number per volume and diameter is N(D) = N0 exp(-L D).

    intercept_per_m4: N0, drops per cubic metre of air and metre of diameter.
    slope_per_m: L.
    """

    intercept_per_m4: float
    slope_per_m: float

    def density_per_m4(self, diameter_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the number of drops per cubic metre of air and metre of diameter."""
        return self.intercept_per_m4 * np.exp(-self.slope_per_m * diameter_m)


# Atlas, Srivastava and Sekhon 1973, Rev. Geophys. 11, 1-35: v = 9.65 - 10.3 exp(-600 D) m/s, D in metres, fitted
# to drops of 0.6 to 5.8 mm at sea level. The paper itself was not at hand; five public restatements agree, one
# naming its equation 24 and one the range of the fit.
FALL_LIMIT_MPS = 9.65
FALL_DEFICIT_MPS = 10.3
FALL_SLOPE_PER_M = 600.0


def fall_speed_mps(diameter_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return the terminal speed of raindrops at sea level; 0 for drops too small for the fit."""
    return np.maximum(FALL_LIMIT_MPS - FALL_DEFICIT_MPS * np.exp(-FALL_SLOPE_PER_M * diameter_m), 0.0)


# Marshall and Palmer 1948, J. Meteorol. 5, 165-166: N0 = 0.08 cm^-4, L = 41 R^-0.21 cm^-1, R in mm/h. The
# paper itself was not at hand: N0 was read in MetrTools dsd.py, both numbers in the code of the course notes
# "week9:marshall" on Stull's chapter 8, and the exponent at www.sjsu.edu/faculty/watkins/raindrop.htm.
MARSHALL_PALMER_INTERCEPT_PER_M4 = 8e6
MARSHALL_PALMER_SLOPE_PER_M = 4100.0
MARSHALL_PALMER_EXPONENT = -0.21


def marshall_palmer(rain_rate_mm_per_h: float) -> ExponentialDrops:
    """Return the Marshall-Palmer drops of a rain rate; ValidityError for one that is not positive.

    An average over many rains; at 10 mm/h its water flux is 16 % larger than the rate.
    At millimetre wavelengths Laws and Parsons' mean drops give notably different results (de Wolf 2001,
    2000RS002369).
    """
    if not rain_rate_mm_per_h > 0:
        message = f"rain_rate_mm_per_h = {rain_rate_mm_per_h:g} must be positive"
        raise ValidityError(message)
    return ExponentialDrops(
        intercept_per_m4=MARSHALL_PALMER_INTERCEPT_PER_M4,
        slope_per_m=MARSHALL_PALMER_SLOPE_PER_M * rain_rate_mm_per_h**MARSHALL_PALMER_EXPONENT,
    )
