"""The resolution of images, in closed form or by one quadrature, and the width of a measured response.

Half-power widths throughout. A side-looking radar at broadside samples the spatial frequency 2 u / lambda along the
track where a scatterer has the direction cosine u; the image of a point is the Fourier transform of the weight W(u)
applied by the beam and the processing,

    h(x) = integral of W(u) exp(4 pi i u x / lambda) du

A flat weight over |u| <= U gives a sinc with its first null at lambda / (4 U). An antenna of length d has the beam
2 U = lambda / d, hence the null at d / 2: half the real aperture's length. Not equalised, its two-way beam is the
squared transform of the taper, so h(x) is the taper convolved with itself, at 2 x: a triangle that ends at d / 2 for
a uniform taper, of half-power width (2 - sqrt 2) d / 2.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from scipy.optimize import brentq
from scipy.signal import get_window

from sionna_radar.imaging.aperture import Aperture
from sionna_radar.radar.antenna import Cut
from sionna_radar.radar.chirp import Chirp

NODES = 4001


def window_factor(window_name: str) -> float:
    """Return the half-power width of a window's spectrum in units of one over its length: 0.886 for a boxcar."""
    weights = get_window(window_name, NODES - 1)
    place = (np.arange(NODES - 1) - (NODES - 1) // 2) / (NODES - 1)

    def response(bins: float) -> float:
        return float(weights @ np.cos(2 * np.pi * bins * place) / weights.sum())

    return 2 * _half_power(response, 0.25)


def slant_range_resolution_m(chirp: Chirp, window_name: str) -> float:
    """Return the half-power width in slant range: c / (2 B) times the window's factor."""
    return chirp.range_resolution_m * window_factor(window_name)


def ground_range_resolution_m(chirp: Chirp, window_name: str, incidence_rad: float) -> float:
    """Return the half-power width on level ground: c / (2 B sin(incidence)) times the window's factor."""
    return slant_range_resolution_m(chirp, window_name) / float(np.sin(incidence_rad))


def real_aperture_resolution_m(azimuth: Cut, range_m: float) -> float:
    """Return the half-power width along the track of an unfocused point: that of the two-way beam at its range."""
    return range_m * half_power_width(azimuth.cosine, azimuth.voltage**4)


def azimuth_resolution_m(aperture: Aperture, wavelength_m: float) -> float:
    """Return the half-power width along the track of a focused point; see the module docstring."""
    u = np.linspace(-aperture.reach, aperture.reach, NODES)
    weight = aperture.weight(u) * aperture.two_way(u)

    def response(place_m: float) -> float:
        return float(weight @ np.cos(4 * np.pi * u * place_m / wavelength_m) / weight.sum())

    return 2 * _half_power(response, wavelength_m / (16 * aperture.reach))


def half_power_width(place: Float[np.ndarray, " n"], power: Float[np.ndarray, " n"]) -> float:
    """Return the width of a response at half its highest sample, the flanks interpolated.

    Raises
    ------
    ValueError
        The response does not fall to half on both sides.

    """
    peak = int(np.argmax(power))
    low = power < power[peak] / 2
    left, right = np.flatnonzero(low[:peak]), np.flatnonzero(low[peak:])
    if len(left) == 0 or len(right) == 0:
        message = "the response does not fall to half its peak inside the axis; widen it"
        raise ValueError(message)
    i, j = int(left[-1]), peak + int(right[0])
    begin = np.interp(power[peak] / 2, power[i : i + 2], place[i : i + 2])
    end = np.interp(-power[peak] / 2, -power[j - 1 : j + 1], place[j - 1 : j + 1])
    return float(end - begin)


def _half_power(response: Callable[[float], float], step: float) -> float:
    """Return where an even response that is one at zero first falls to half its power."""
    end = step
    while response(end) > np.sqrt(0.5):
        end += step
    return float(brentq(lambda x: response(x) - np.sqrt(0.5), end - step, end))
