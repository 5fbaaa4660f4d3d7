"""Antennas by their gain alone, the end of the main lobe, patterns of the whole sphere, and arrays by sums by hand."""

from itertools import product

import numpy as np
import pytest
from scipy.special import erf

from beams import make_antenna, plane_power
from sionna_radar.flight.frames import steering
from sionna_radar.radar.antenna import (
    FOLDING,
    FOLLOWED,
    LIT,
    Antenna,
    Cut,
    antenna_of,
    in_main_lobe,
    lobe_samples,
    measured_cut,
    reach_of_power,
)
from sionna_radar.radar.array_antenna import taylor_cut
from sionna_radar.radar.array_pattern import ArrayPattern, ElementPattern, array_factor, steered
from sionna_radar.radar.build import build_antenna
from sionna_radar.radar.equation import plane_echo, two_way_beam_sr
from sionna_radar.radar.pattern import ProductPattern, SphericalPattern, angles_of, directions_of
from sionna_radar.scenario.radar import AntennaTable
from sionna_radar.surfaces.backscatter import ConstantGammaBackscatter
from worlds import GAMMA


def azimuth_gain(antenna: Antenna, angle_rad: np.ndarray) -> np.ndarray:
    """Gain against the angle from boresight in the plane of boresight and left."""
    return antenna.gain(np.column_stack([np.cos(angle_rad), np.sin(angle_rad), np.zeros_like(angle_rad)]))


def elevation_gain(antenna: Antenna, angle_rad: np.ndarray) -> np.ndarray:
    """Gain against the angle from boresight in the plane of boresight and up."""
    return antenna.gain(np.column_stack([np.cos(angle_rad), np.zeros_like(angle_rad), np.sin(angle_rad)]))


def measure(gain: np.ndarray, angle_rad: np.ndarray) -> tuple[float, float, float]:
    """Return half-power width (rad), highest side lobe (dB) and the angle of the first null (rad)."""
    level = gain / gain[0]
    half = int(np.argmax(level < 0.5))
    width = 2 * np.interp(0.5, level[[half, half - 1]], angle_rad[[half, half - 1]])
    rising = np.flatnonzero(np.diff(level) > 0)
    if len(rising) == 0:
        return width, -np.inf, np.pi / 2
    return width, 10 * np.log10(level[rising[0] :].max()), float(angle_rad[rising[0]])


@pytest.mark.parametrize(
    ("beamwidth_deg", "side_lobe_db"),
    [
        *((0.5, -40.0), (1.0, -15.0), (1.0, -40.0)),  # hundreds of elements, half a second and more each
        *product([2.0, 4.0, 8.0, 15.0, 25.0, 30.0, 40.0], [-15.0, -20.0, -25.0, -30.0, -40.0]),
    ],
)
def test_beamwidth_and_side_lobe_are_the_wanted_ones(beamwidth_deg, side_lobe_db):
    cut = taylor_cut(np.deg2rad(beamwidth_deg), side_lobe_db)
    antenna = Antenna(cut, cut)
    angle = np.linspace(0, np.pi / 2, 20_001)
    for pattern in (azimuth_gain, elevation_gain):
        width, side_lobe, _ = measure(pattern(antenna, angle), angle)
        assert np.rad2deg(width) == pytest.approx(beamwidth_deg, rel=0.01)
        if np.isfinite(side_lobe) or beamwidth_deg <= 30:  # a wider beam may end before its first null
            assert side_lobe == pytest.approx(side_lobe_db, abs=0.5)


def test_azimuth_and_elevation_have_a_width_each():
    antenna = build_antenna(AntennaTable(beamwidth_deg=(6.0, 3.0), side_lobe_db=-25.0))
    angle = np.linspace(0, np.pi / 2, 100_001)
    assert np.rad2deg(measure(azimuth_gain(antenna, angle), angle)[0]) == pytest.approx(6.0, rel=0.01)
    assert np.rad2deg(measure(elevation_gain(antenna, angle), angle)[0]) == pytest.approx(3.0, rel=0.01)
    np.testing.assert_allclose(np.rad2deg(antenna.beamwidths_rad), [6.0, 3.0], rtol=1e-4)


def sphere_integral(antenna: Antenna, fine_rad: float) -> float:
    """Integral of the gain over all directions, in azimuth and elevation angles about the boresight."""
    coarse = np.linspace(-np.pi / 2, np.pi / 2, 361)
    angle = np.unique(np.concatenate([coarse, np.linspace(-fine_rad, fine_rad, 301)]))
    azimuth, elevation = np.meshgrid(angle, angle, indexing="ij")
    direction = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=-1
    )
    density = antenna.gain(direction.reshape(-1, 3)).reshape(azimuth.shape) * np.cos(elevation)
    return float(np.trapezoid(np.trapezoid(density, angle, axis=1), angle))


@pytest.mark.parametrize(("azimuth_deg", "elevation_deg"), [(2.0, 2.0), (6.0, 3.0), (1.0, 20.0), (40.0, 40.0)])
def test_the_antenna_is_lossless(azimuth_deg, elevation_deg):
    antenna = make_antenna(azimuth_deg, elevation_deg)
    assert sphere_integral(antenna, np.deg2rad(6.0)) == pytest.approx(4 * np.pi, rel=2e-3)


def test_gain_of_a_uniform_aperture_is_its_textbook_value():
    # A large uniform square of side L wavelengths: gain 4 pi L^2, half-power width 0.886 / L.
    length = 20.0
    u = np.linspace(-1, 1, 20001)
    cut = Cut(np.sinc(length * u))
    antenna = Antenna(cut, cut)
    assert 10 * np.log10(antenna.peak_gain) == pytest.approx(10 * np.log10(4 * np.pi * length**2), abs=0.1)
    assert antenna.beamwidths_rad[0] == pytest.approx(0.886 / length, rel=2e-3)
    assert 10 * np.log10(cut.side_lobe_level) == pytest.approx(-13.26, abs=0.05)


def test_gain_peaks_on_boresight_and_nothing_goes_backward(pencil):
    away = np.random.default_rng(1).normal(size=(5000, 3))
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    gain = pencil.gain(away)
    assert pencil.gain(np.array([[1.0, 0, 0]]))[0] == pytest.approx(pencil.peak_gain)
    assert gain.max() < pencil.peak_gain
    np.testing.assert_array_equal(gain[away[:, 0] <= 0], 0.0)


def test_a_measured_cut_returns_the_measurement():
    # A Gaussian beam of 5 deg: 3.0103 dB down 2.5 deg off boresight, and a floor at -30 dB.
    angle_deg = np.arange(-40.0, 40.01, 0.25)
    power_db = np.maximum(-3.0103 * (angle_deg / 2.5) ** 2, -30.0) + 17.0  # the level is arbitrary
    cut = measured_cut(np.deg2rad(angle_deg), power_db)
    at = np.array([0.0, 2.5, -5.0, 20.0, 80.0])
    expected_db = [0.0, -3.0103, -12.0412, -30.0, -30.0]
    np.testing.assert_allclose(20 * np.log10(cut.at(np.sin(np.deg2rad(at)))), expected_db, atol=0.02)


def test_a_measured_cut_may_squint():
    angle_deg = np.arange(-30.0, 30.01, 0.1)
    cut = measured_cut(np.deg2rad(angle_deg), -3.0103 * ((angle_deg - 4.0) / 2.5) ** 2)
    assert np.rad2deg(np.arcsin(cut.cosine[np.argmax(cut.voltage)])) == pytest.approx(4.0, abs=0.1)
    assert np.rad2deg(cut.half_power_width_rad) == pytest.approx(5.0, rel=0.01)


def test_an_unsorted_measurement_is_refused():
    with pytest.raises(ValueError, match="increase"):
        measured_cut(np.array([0.0, 0.2, 0.1]), np.zeros(3))


def direction(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the unit vectors with some direction cosines to the left and up."""
    return np.column_stack([np.sqrt(1 - u**2 - v**2), u, v])


@pytest.mark.parametrize("azimuth_deg", [1.0, 4.0, 12.0])
def test_the_lit_lobe_ends_at_the_half_power_angles(azimuth_deg):
    """A quarter of the two-way power is a half of the one-way power."""
    antenna = make_antenna(azimuth_deg, 2.0)
    half = antenna.beamwidths_rad[0] / 2
    angle = half * np.array([-1.01, -0.99, 0.0, 0.99, 1.01])
    lit = in_main_lobe(antenna, direction(np.sin(angle), np.zeros(5)))
    np.testing.assert_array_equal(lit, [False, True, True, True, False])


def test_the_lobe_ends_off_both_axes_together():
    """Half a beamwidth aside in both planes the two-way power is a sixteenth."""
    antenna = make_antenna(2.0, 4.0)
    azimuth, elevation = (np.sin(width / 2) for width in antenna.beamwidths_rad)
    corner = direction(np.array([azimuth]), np.array([elevation]))
    assert not in_main_lobe(antenna, corner, LIT)[0]
    assert in_main_lobe(antenna, corner, 1 / 17)[0]
    assert not in_main_lobe(antenna, corner, 1 / 15)[0]


@pytest.mark.parametrize("level", [LIT, FOLLOWED])
def test_the_lobe_is_where_the_two_way_gain_says_so(level):
    antenna = make_antenna(5.0, 3.0)
    towards = np.random.default_rng(1).normal([1.0, 0.0, 0.0], 0.05, (5000, 3))
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    expected = antenna.gain(towards) ** 2 >= level * antenna.peak_gain**2
    assert 0.05 < expected.mean() < 0.95
    np.testing.assert_array_equal(in_main_lobe(antenna, towards, level), expected)
    assert not in_main_lobe(antenna, -towards, level).any()


@pytest.mark.parametrize("level", [LIT, FOLDING, FOLLOWED])
def test_the_samples_of_a_gaussian_lobe_reach_to_its_level(level):
    """exp(-u^2 / (2 s^2)) to the fourth power falls to a level L at u = s sqrt(ln(1 / L) / 2)."""
    spread, count = 0.02, 4001
    cut = Cut(np.exp(-(np.linspace(-1, 1, count) ** 2) / (2 * spread**2)))
    kept = cut.cosine[lobe_samples(cut, level)]
    expected = spread * np.sqrt(np.log(1 / level) / 2)
    assert kept[0] == pytest.approx(-expected, abs=2 / (count - 1))
    assert kept[-1] == pytest.approx(expected, abs=2 / (count - 1))


def test_a_side_lobe_above_the_level_is_not_part_of_the_lobe():
    u = np.linspace(-1, 1, 2001)
    cut = Cut(np.exp(-((u / 0.02) ** 2)) + 0.8 * np.exp(-(((u - 0.3) / 0.02) ** 2)))
    kept = cut.cosine[lobe_samples(cut, 1e-2)]
    assert kept[0] > -0.05
    assert kept[-1] < 0.05


def test_a_lobe_without_an_end_is_the_whole_cut():
    assert lobe_samples(Cut(np.ones(101)), 0.25) == slice(0, 101)


@pytest.mark.parametrize("outside", [0.5, 0.1, 1e-3])
def test_all_but_a_share_of_the_power_lies_within_reach(outside):
    """Of a cut as wide as the sky the power within u is u itself."""
    sky = Cut(np.ones(2001))
    assert reach_of_power(Antenna(sky, sky), outside) == pytest.approx((1 - outside,) * 2, abs=1e-6)
    antenna = make_antenna(2.0, 2.0)
    reach, _ = reach_of_power(antenna, outside)
    cut = antenna.azimuth
    power, inside = cut.voltage**4, np.abs(cut.cosine) <= reach
    assert power[inside].sum() / power.sum() == pytest.approx(1 - outside, abs=0.02)


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
