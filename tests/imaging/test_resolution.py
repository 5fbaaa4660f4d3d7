"""The closed forms of resolution."""

import numpy as np
import pytest

from sionna_radar.imaging.aperture import Aperture
from sionna_radar.imaging.strip import (
    azimuth_resolution_m,
    ground_range_resolution_m,
    half_power_width,
    slant_range_resolution_m,
    window_factor,
)
from sionna_radar.radar.antenna import Cut
from sionna_radar.radar.chirp import Chirp

CHIRP = Chirp(carrier_hz=77e9, bandwidth_hz=500e6, rate_hz=1000.0, samples=256)
WAVELENGTH = CHIRP.wavelength_m


def uniform(length_m: float) -> Cut:
    return Cut(np.sinc(length_m / WAVELENGTH * np.linspace(-1.0, 1.0, 40_001)))


# Harris 1978, "On the use of windows", Table 1: 3.0 dB bandwidths 0.89, 1.44 and 1.30 bins.
@pytest.mark.parametrize(("name", "bins"), [("boxcar", 0.8859), ("hann", 1.4406), ("hamming", 1.303)])
def test_window_factors(name, bins):
    assert window_factor(name) == pytest.approx(bins, abs=0.002)


def test_range_resolution():
    assert slant_range_resolution_m(CHIRP, "boxcar") == pytest.approx(0.8859 * 0.29979, rel=1e-3)
    assert ground_range_resolution_m(CHIRP, "boxcar", np.deg2rad(30)) == pytest.approx(2 * 0.8859 * 0.29979, rel=1e-3)


def test_flat_weight_over_the_beam_is_half_the_antenna():
    length = 0.05
    aperture = Aperture(width_rad=2 * np.arcsin(WAVELENGTH / length / 2), azimuth=uniform(length), weighting="flat")
    assert azimuth_resolution_m(aperture, WAVELENGTH) == pytest.approx(0.8859 * length / 2, rel=1e-3)


def test_the_whole_two_way_beam_of_a_uniform_aperture_gives_a_triangle():
    """The taper convolved with itself at 2 x: 1 - 2 |x| / d, down to sqrt(1/2) at (1 - sqrt(1/2)) d / 2."""
    length = 0.25
    aperture = Aperture(width_rad=2.0, azimuth=uniform(length))
    assert azimuth_resolution_m(aperture, WAVELENGTH) == pytest.approx((1 - np.sqrt(0.5)) * length, rel=5e-3)


def test_the_whole_two_way_beam_of_a_tapered_array_gives_its_taper_convolved_with_itself():
    from scipy.signal.windows import taylor

    elements, step = 200, WAVELENGTH / 4
    weights = taylor(elements, nbar=4, sll=25, norm=False)
    u = np.linspace(-1.0, 1.0, 8001)
    place = (np.arange(elements) - (elements - 1) / 2) * step
    voltage = np.array([weights @ np.cos(2 * np.pi * place * x / WAVELENGTH) for x in u]) / weights.sum()
    response = np.convolve(weights, weights)
    axis = (np.arange(len(response)) - (elements - 1)) * step / 2
    expected = half_power_width(axis, response**2)
    aperture = Aperture(width_rad=1.0, azimuth=Cut(voltage))
    assert azimuth_resolution_m(aperture, WAVELENGTH) == pytest.approx(expected, rel=0.01)


def test_width_of_a_measured_response():
    x = np.linspace(-3.0, 3.0, 601)
    assert half_power_width(x, np.sinc(x) ** 2) == pytest.approx(0.8859, abs=1e-3)
    with pytest.raises(ValueError, match="widen"):
        half_power_width(x[:310], np.sinc(x[:310]) ** 2)
