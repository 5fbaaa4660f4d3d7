"""Antennas, measured on their gain alone: beamwidth, side lobes, and the energy they send."""

import numpy as np
import pytest

from beams import make_antenna
from sionna_radar.radar.antenna import Antenna, Cut, build_antenna, measured_cut
from sionna_radar.radar.array_antenna import taylor_cut
from sionna_radar.scenario.radar import AntennaTable


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


@pytest.mark.parametrize("side_lobe_db", [-15.0, -20.0, -25.0, -30.0, -40.0])
@pytest.mark.parametrize("beamwidth_deg", [0.5, 1.0, 2.0, 4.0, 8.0, 15.0, 25.0, 30.0, 40.0])
def test_beamwidth_and_side_lobe_are_the_wanted_ones(beamwidth_deg, side_lobe_db):
    cut = taylor_cut(np.deg2rad(beamwidth_deg), side_lobe_db)
    antenna = Antenna(cut, cut)
    angle = np.linspace(0, np.pi / 2, 100_001)
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
    coarse = np.linspace(-np.pi / 2, np.pi / 2, 721)
    angle = np.unique(np.concatenate([coarse, np.linspace(-fine_rad, fine_rad, 601)]))
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


def test_gain_is_symmetric(pencil):
    away = np.array([[0.99, 0.1, -0.0995]])
    for signs in ([1, -1, 1], [1, 1, -1], [1, -1, -1]):
        np.testing.assert_allclose(pencil.gain(away * signs), pencil.gain(away), rtol=1e-9)


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
