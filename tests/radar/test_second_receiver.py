"""Receivers beside the first: baselines, and the difference of an aperture's halves."""

import numpy as np
import pytest

from beams import make_antenna
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.radar.antenna import Cut, antenna_of, two_way_spread
from sionna_radar.radar.build import build_chirp, build_receivers
from sionna_radar.radar.mimo_array import difference_pattern
from sionna_radar.radar.pattern import SphericalPattern
from sionna_radar.scenario.radar import RadarTable

WIDE = make_antenna(8.0, 8.0)
WAVELENGTH_M = 299792458 / 77e9


def built(antenna=WIDE, **table):
    radar = RadarTable(snr_db=30.0, second_receiver=table or None)
    return build_receivers(radar.second_receiver, antenna, build_chirp(radar), 1 / radar.chirp_rate_hz)


def test_halves_of_a_uniform_aperture_have_a_ratio_of_the_tangent():
    """Their phase centres are half an aperture apart, so that the ratio is tan of half the phase between them."""
    aperture = 7.0  # wavelengths
    u = np.linspace(-1, 1, 2 * 1792 + 1)
    ratio = difference_pattern(Cut(np.sinc(aperture * u)), 1)
    inside = np.linspace(-0.09, 0.09, 31)
    np.testing.assert_allclose(ratio.at(inside), np.tan(np.pi * aperture * inside / 2), atol=0.02)
    assert ratio.slope == pytest.approx(np.pi * aperture / 2, rel=0.01)
    np.testing.assert_allclose(ratio.cosine_of(ratio.at(inside)), inside, atol=1e-6)


def test_a_taper_draws_the_halves_together():
    """The slope of the ratio is k times the mean distance of the aperture's halves from its middle."""
    tapered, uniform = (difference_pattern(make_antenna(8.0, width).elevation, 2).slope for width in (8.0, 4.0))
    assert uniform == pytest.approx(2 * tapered, rel=0.05)


def test_none_without_a_table():
    assert built() is None


def test_axes_and_the_baseline_of_its_own_choice():
    both = built(axis="both")
    assert (both.receiver_m > 0).tolist() == [[False] * 3, [False, True, False], [False, False, True]]
    phase = 2 * np.pi * both.receiver_m[2, 2] / WAVELENGTH_M * two_way_spread(WIDE)[1]
    assert phase == pytest.approx(0.25)


def test_what_calibration_does_not_know_is_in_the_truth_alone():
    pair = built(axis="elevation", baseline_wavelengths=2.0, baseline_error_wavelengths=0.1, phase_error_deg=90.0)
    assert pair.receiver_m[1, 2] == pytest.approx(2.0 * WAVELENGTH_M)
    assert pair.true_receiver_m[1, 2] == pytest.approx(2.1 * WAVELENGTH_M)
    # The beats of an up-sweep turn against the phase of a path's gain.
    np.testing.assert_allclose(np.diag(pair.mixing), [1.0, -1j], atol=1e-12)
    known = pair.calibrated
    assert known.true_receiver_m is known.mixing is None


def test_a_baseline_that_wraps_inside_the_main_lobe_is_refused():
    with pytest.raises(ScenarioError, match=r"baseline_wavelengths: 20 wraps the phase .* lower it to"):
        built(axis="elevation", baseline_wavelengths=20.0)


def test_halves_need_an_antenna_that_has_some():
    horn = antenna_of(SphericalPattern.of(lambda d: np.maximum(d[:, 0], 0) ** 50, step_rad=np.deg2rad(1.0)))
    with pytest.raises(ScenarioError, match=r"second_receiver.kind: 'monopulse' splits"):
        built(horn, kind="monopulse")


@pytest.mark.parametrize("key", ["baseline_wavelengths", "phase_error_deg"])
def test_halves_have_no_baseline(key):
    with pytest.raises(ScenarioError, match=f"{key}: has no effect on kind = 'monopulse'"):
        built(kind="monopulse", **{key: 1.0})
