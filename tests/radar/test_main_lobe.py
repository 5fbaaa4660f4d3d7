"""The end of the main lobe: half-power angles, nulls, and the share of the power beyond them."""

import numpy as np
import pytest

from beams import make_antenna
from sionna_radar.radar.antenna import Antenna, Cut
from sionna_radar.radar.main_lobe import FOLDING, FOLLOWED, LIT, in_main_lobe, lobe_samples, reach_of_power


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
