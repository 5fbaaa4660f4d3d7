"""The real-aperture image of a side-looking radar, and the closed forms of resolution."""

import dataclasses

import numpy as np
import pytest

from side_looking import make_flight, uniform_cut
from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.radar.antenna import Cut
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scene.model import Target
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.signal.beat import synthesise
from sionna_radar.studies.images.aperture import Aperture
from sionna_radar.studies.images.strip import (
    SideLooking,
    azimuth_resolution_m,
    ground_range_resolution_m,
    half_power_width,
    real_aperture_resolution_m,
    slant_range_resolution_m,
    to_ground,
    window_factor,
)
from sionna_radar.tracing.effects.targets import trace_targets


@pytest.fixture(scope="module")
def caster(plane):
    return RayCaster(plane.surfaces)


def slant_range_image(beats, measured, analyser, step_m):
    imager = SideLooking(analyser, step_m)
    imager.add(beats, measured)
    return imager.image()


def compressed(flight, caster, pulses, *ground_m: float, zero_padding: int = 16):
    targets = [Target(position_m=(g, 0.0, 0.0), rcs_m2=1.0) for g in ground_m]
    beats = synthesise(trace_targets(targets, pulses, flight.antenna, flight.chirp, caster), pulses, flight.chirp)
    return beats, SpectrumAnalyser(flight.chirp, "hann", zero_padding)


@pytest.mark.parametrize("incidence_deg", [38.0, 45.0, 52.0])
def test_ground_range_resolution_is_the_theorys(caster, incidence_deg):
    flight = make_flight()
    pulses = flight.pulses(0.1)
    place = 28.0 * np.tan(np.deg2rad(incidence_deg))
    beats, analyser = compressed(flight, caster, pulses, place)
    image = slant_range_image(beats, pulses.measured, analyser, 1.0)
    ground_m = np.arange(15.0, 45.0, 0.01)
    power = to_ground(image, 0.0, ground_m)[0]
    width = half_power_width(ground_m, np.nan_to_num(power))
    assert width == pytest.approx(ground_range_resolution_m(flight.chirp, "hann", np.deg2rad(incidence_deg)), rel=0.05)
    assert ground_m[np.nanargmax(power)] == pytest.approx(place, abs=0.02)


def test_along_the_track_it_resolves_the_two_way_beam(caster):
    flight = make_flight()
    pulses = flight.pulses(4.0, every=4)
    beats, analyser = compressed(flight, caster, pulses, 28.0, zero_padding=4)
    image = slant_range_image(beats, pulses.measured, analyser, 0.05)
    width = half_power_width(image.along_m, image.power.max(axis=1))
    cut = flight.antenna.azimuth
    assert width == pytest.approx(real_aperture_resolution_m(cut, 28.0 * np.sqrt(2)), rel=0.03)
    assert image.along_m[np.argmax(image.power.max(axis=1))] == pytest.approx(4.0, abs=0.05)


def test_power_is_the_points_at_the_middle_of_the_beam(caster):
    flight = make_flight()
    pulses = flight.pulses(0.02)
    beats, analyser = compressed(flight, caster, pulses, 28.0)
    image = slant_range_image(beats, pulses.measured, analyser, 1.0)
    range_m = 28.0 * np.sqrt(2)
    expected = flight.antenna.peak_gain**2 * flight.chirp.wavelength_m**2 / ((4 * np.pi) ** 3 * range_m**4)
    assert image.power.max() == pytest.approx(expected, rel=0.02)


def test_doppler_of_the_measured_velocity_is_taken_out(caster):
    """A climb of 2 m/s moves the echo by f0 v T / B; the measured velocity puts it back."""
    flight = make_flight()
    pulses = flight.pulses(0.02)
    climbing = dataclasses.replace(pulses.true, velocity_mps=pulses.true.velocity_mps + np.array([0.0, 0.0, 2.0]))
    pulses = dataclasses.replace(pulses, true=climbing, measured=climbing)
    beats, analyser = compressed(flight, caster, pulses, 28.0)
    image = slant_range_image(beats, pulses.measured, analyser, 1.0)
    raw = analyser.range_m[np.argmax(analyser.power(beats)[0])]
    assert raw == pytest.approx(28.0 * np.sqrt(2) + 77e9 * 2.0 / np.sqrt(2) / 1000 / 500e6, abs=0.03)
    assert image.range_m[np.nanargmax(image.power[0])] == pytest.approx(28.0 * np.sqrt(2), abs=0.03)


def test_blocks_do_not_change_the_image_and_gaps_are_empty(caster):
    flight = make_flight()
    pulses = flight.pulses(1.0, every=8)
    beats, analyser = compressed(flight, caster, pulses, 28.0, zero_padding=1)
    whole = slant_range_image(beats, pulses.measured, analyser, 0.3)
    growing = SideLooking(analyser, 0.3)
    for part in (slice(0, 7), slice(7, 20), slice(20, None)):
        growing.add(beats[part], pulses.measured.rows(part))
    np.testing.assert_allclose(growing.image().power, whole.power, rtol=1e-9)
    sparse = slant_range_image(beats, pulses.measured, analyser, 0.01)
    assert np.isnan(sparse.power).all(axis=1).any()
    assert np.isnan(to_ground(sparse, 0.0, np.array([20.0]))).any()


def test_no_pulses_make_no_image():
    with pytest.raises(ValueError, match="no pulses"):
        SideLooking(SpectrumAnalyser(make_flight().chirp, "hann", 1), 1.0).image()


CHIRP = Chirp(carrier_hz=77e9, bandwidth_hz=500e6, rate_hz=1000.0, samples=256)
WAVELENGTH = CHIRP.wavelength_m


# Harris 1978, "On the use of windows", Table 1: 3.0 dB bandwidths 0.89, 1.44 and 1.30 bins.
@pytest.mark.parametrize(("name", "bins"), [("boxcar", 0.8859), ("hann", 1.4406), ("hamming", 1.303)])
def test_window_factors(name, bins):
    assert window_factor(name) == pytest.approx(bins, abs=0.002)


def test_range_resolution():
    assert slant_range_resolution_m(CHIRP, "boxcar") == pytest.approx(0.8859 * 0.29979, rel=1e-3)
    assert ground_range_resolution_m(CHIRP, "boxcar", np.deg2rad(30)) == pytest.approx(2 * 0.8859 * 0.29979, rel=1e-3)


def test_flat_weight_over_the_beam_is_half_the_antenna():
    length = 0.05
    aperture = Aperture(
        width_rad=2 * np.arcsin(WAVELENGTH / length / 2), azimuth=uniform_cut(length, WAVELENGTH), weighting="flat"
    )
    assert azimuth_resolution_m(aperture, WAVELENGTH) == pytest.approx(0.8859 * length / 2, rel=1e-3)


def test_the_whole_two_way_beam_of_a_uniform_aperture_gives_a_triangle():
    """The taper convolved with itself at 2 x: 1 - 2 |x| / d, down to sqrt(1/2) at (1 - sqrt(1/2)) d / 2."""
    length = 0.25
    aperture = Aperture(width_rad=2.0, azimuth=uniform_cut(length, WAVELENGTH))
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
