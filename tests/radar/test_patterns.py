"""Patterns of the whole sphere and arrays: against sums by hand, closed forms, and the separable antenna."""

import numpy as np
import pytest
from scipy.special import erf

from beams import make_antenna, plane_power
from sionna_radar.flight.frames import steering
from sionna_radar.radar.antenna import antenna_of
from sionna_radar.radar.array_pattern import ArrayPattern, ElementPattern, array_factor, steered
from sionna_radar.radar.equation import plane_echo, two_way_beam_sr
from sionna_radar.radar.main_lobe import reach_of_power
from sionna_radar.radar.pattern import ProductPattern, SphericalPattern, angles_of, directions_of
from sionna_radar.surfaces.backscatter import ConstantGammaBackscatter
from worlds import GAMMA


def some_directions(count: int = 2000) -> np.ndarray:
    away = np.random.default_rng(5).normal(size=(count, 3))
    return away / np.linalg.norm(away, axis=1, keepdims=True)


def line_of(elements: int, spacing: float) -> np.ndarray:
    """Places in wavelengths of a line of elements from right to left."""
    return np.column_stack([(np.arange(elements) - (elements - 1) / 2) * spacing, np.zeros(elements)])


def array(columns: int, rows: int, spacing: float, exponent: float = 1.0) -> ArrayPattern:
    left, up = np.meshgrid(np.arange(columns) * spacing, np.arange(rows) * spacing, indexing="ij")
    place = np.column_stack([left.ravel(), up.ravel()])
    factor = array_factor(place, np.ones(len(place), dtype=complex))
    return ArrayPattern(factor, ElementPattern(exponent), (columns * spacing, rows * spacing))


def test_angles_and_directions_are_inverse():
    away = some_directions()
    np.testing.assert_allclose(directions_of(*angles_of(away)), away, atol=1e-12)


@pytest.mark.parametrize("exponent", [1.0, 4.0, 50.0])
def test_directivity_of_a_power_of_the_cosine(exponent):
    """Power cos^n over the half sphere integrates to 2 pi / (n + 1)."""
    pattern = SphericalPattern.of(lambda d: np.maximum(d[:, 0], 0.0) ** (exponent / 2), np.deg2rad(0.5))
    assert pattern.directivity == pytest.approx(2 * (exponent + 1), rel=1e-3)
    assert antenna_of(pattern, efficiency=0.5).peak_gain == pytest.approx(exponent + 1, rel=1e-3)


def test_directivity_of_a_product_of_gaussian_cuts():
    """A narrow Gaussian beam's solid angle is the product of both integrals."""
    wide, high = np.deg2rad([3.0, 1.5])
    azimuth, elevation = np.linspace(-np.pi, np.pi, 72_001), np.linspace(-np.pi / 2, np.pi / 2, 36_001)
    pattern = ProductPattern(np.exp(-0.5 * (azimuth / wide) ** 2), np.exp(-0.5 * (elevation / high) ** 2))
    solid_angle = np.pi * wide * high * erf(np.pi / wide) * np.exp(-(high**2) / 4)  # cos(el) = Re exp(i el)
    assert pattern.directivity == pytest.approx(4 * np.pi / solid_angle, rel=1e-5)


@pytest.fixture(scope="module")
def sampled():
    """The separable antenna of 4 by 6 degrees, and itself as samples of the whole sphere."""
    own = make_antenna(4.0, 6.0)
    return own, antenna_of(SphericalPattern.of(lambda d: np.sqrt(own.gain(d)), np.deg2rad(0.1)))


def test_a_sampled_antenna_is_the_one_it_was_sampled_from(sampled):
    own, copy = sampled
    assert copy.peak_gain == pytest.approx(own.peak_gain, rel=2e-3)
    assert copy.beamwidths_rad == pytest.approx(own.beamwidths_rad, rel=2e-3)
    away = directions_of(*np.random.default_rng(2).normal(scale=0.1, size=(2, 1000)))
    np.testing.assert_allclose(copy.gain(away), own.gain(away), atol=2e-3 * own.peak_gain)
    u = np.linspace(-0.3, 0.3, 301)
    np.testing.assert_allclose(copy.azimuth.at(u) ** 4, own.azimuth.at(u) ** 4 * (1 - u**2), atol=2e-3)


def test_the_echo_of_a_plane_is_the_same_by_cells_as_by_cuts(sampled):
    own, copy = sampled
    surface = ConstantGammaBackscatter(GAMMA)
    for incidence_deg in (0.0, 45.0):
        echoes = [plane_echo(a, surface, 3.9e-3, 50.0, np.deg2rad(incidence_deg)) for a in (own, copy)]
        assert echoes[1] == pytest.approx(echoes[0], rel=5e-3)
    assert two_way_beam_sr(copy) == pytest.approx(two_way_beam_sr(own), rel=5e-3)
    assert reach_of_power(copy, 1e-2) == pytest.approx(reach_of_power(own, 1e-2), rel=0.1)


def test_transmission_and_reception_may_differ():
    sent, heard = make_antenna(4.0, 6.0), make_antenna(10.0, 3.0)
    patterns = [SphericalPattern.of(lambda d, a=a: np.sqrt(a.gain(d)), np.deg2rad(0.1)) for a in (sent, heard)]
    both = antenna_of(*patterns)
    away = directions_of(*np.random.default_rng(2).normal(scale=0.05, size=(2, 500)))
    product = sent.gain(away) * heard.gain(away)
    np.testing.assert_allclose(both.gain(away) ** 2, product, atol=1e-2 * both.peak_gain**2)
    assert both.peak_gain**2 == pytest.approx(sent.peak_gain * heard.peak_gain, rel=1e-2)
    surface, wavelength_m = ConstantGammaBackscatter(GAMMA), 299_792_458.0 / 77e9
    echo = plane_echo(both, surface, wavelength_m, 50.0, np.deg2rad(45.0))
    assert echo == pytest.approx(plane_power(both, 50.0, 45.0), rel=5e-3)


def test_the_array_factor_is_the_sum_over_the_elements():
    place = np.random.default_rng(1).uniform(-4, 4, size=(60, 2))
    weight = np.exp(2j * np.pi * np.random.default_rng(2).random(60))
    factor = array_factor(place, weight)
    away = some_directions()
    direct = np.abs(np.exp(2j * np.pi * (away[:, 1:] @ place.T)) @ weight) / 60
    np.testing.assert_allclose(
        factor.at(away[:, 1], away[:, 2]), direct, atol=1.2e-2
    )  # magnitudes between samples miss the cusps of nulls


def test_a_uniform_array_has_the_textbook_beam():
    """Half-power width 0.886 / L, first side lobe -13.26 dB, directivity 4 pi A / lambda^2 (Balanis, ch. 6 and 12)."""
    antenna = antenna_of(array(40, 20, 0.5))
    assert antenna.beamwidths_rad == pytest.approx((0.886 / 20, 0.886 / 10), rel=5e-3)
    assert antenna.peak_gain == pytest.approx(4 * np.pi * 20 * 10, rel=1e-2)
    assert 10 * np.log10(antenna.azimuth.side_lobe_level) == pytest.approx(-13.26, abs=0.15)


@pytest.mark.parametrize("degrees", [0.0, 20.0, 45.0])
def test_a_steered_beam_widens_and_weakens(degrees):
    """By the cosine of the angle, as its projected aperture shrinks; its axis stays where it was steered to."""
    broadside = antenna_of(array(40, 20, 0.5))
    turned_beam = steered(broadside, np.deg2rad(degrees))
    shrink = np.cos(np.deg2rad(degrees))
    assert turned_beam.beamwidths_rad[0] == pytest.approx(broadside.beamwidths_rad[0] / shrink, rel=0.01)
    assert turned_beam.beamwidths_rad[1] == pytest.approx(broadside.beamwidths_rad[1], rel=0.01)
    assert turned_beam.peak_gain == pytest.approx(broadside.peak_gain * shrink, rel=0.02)
    near = directions_of(*np.random.default_rng(3).normal(scale=0.05, size=(2, 500)))
    assert turned_beam.gain(near).max() <= 1.01 * turned_beam.gain(np.array([[1.0, 0.0, 0.0]]))[0]


def test_wide_spacing_brings_a_grating_lobe():
    """Elements d apart repeat the beam at sin t = sin t0 - lambda / d, as weak as their own pattern is there."""
    face, exponent = np.deg2rad(30.0), 1.0
    antenna = steered(antenna_of(array(32, 8, 0.8, exponent)), face)
    lobe = np.arcsin(np.sin(face) - 1 / 0.8)
    in_beam_frame = directions_of(np.array([lobe]), np.zeros(1)) @ steering(face, 0.0)
    expected = (np.cos(lobe) / np.cos(face)) ** exponent
    assert antenna.gain(in_beam_frame)[0] / antenna.peak_gain == pytest.approx(expected, rel=0.02)


def test_a_line_of_elements_has_no_beam_along_the_line():
    factor = array_factor(line_of(8, 0.5), np.ones(8, dtype=complex))
    assert factor.at(np.zeros(3), np.array([-0.9, 0.0, 0.9])) == pytest.approx(1.0, abs=1e-6)
