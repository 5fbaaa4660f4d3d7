"""What the wind does to plants and to water: Billingsley's spectrum, JONSWAP waves, orbits and ripples."""

import numpy as np
import pytest
from scipy.constants import g as gravity

from sionna_radar.surfaces.motion import TENSION_M3_PER_S2, Waves, Windblown, jonswap, peak_rate

CARRIER_HZ = 77e9
WIND = np.array([6.0, 8.0])


def test_plants_at_x_band_are_those_that_were_measured():
    """At 9.2 GHz and 10 mph as much stands still as moves, to a decibel; at VHF nearly all stands still."""
    wind_mps = 10 * 0.44704
    at_x_band, at_vhf = (Windblown.of(wind_mps, f).static_fraction for f in (9.2e9, 170e6))
    assert 10 * np.log10(at_x_band / (1 - at_x_band)) == pytest.approx(-0.26, abs=0.05)
    assert at_vhf > 0.99
    # The mean speed does not depend on the frequency.
    assert Windblown.of(wind_mps, CARRIER_HZ).mean_shift_hz / CARRIER_HZ == pytest.approx(
        Windblown.of(wind_mps, 9.2e9).mean_shift_hz / 9.2e9
    )


def test_scatterers_lose_their_correlation_as_the_spectrum_says():
    plants, lag_s = Windblown.of(5.0, CARRIER_HZ), np.array([0.0, 0.5e-3, 2e-3, 10e-3, 1.0])
    number = np.random.default_rng(1).random((200_000, 2))
    fields = [np.exp(2j * np.pi * plants.shift_hz(number) * (7.0 + lag)) for lag in lag_s]
    correlation = [np.vdot(fields[0], field).real / len(number) for field in fields]
    np.testing.assert_allclose(correlation, plants.field_correlation(lag_s), atol=0.01)
    assert correlation[-1] == pytest.approx(plants.static_fraction, abs=0.01)


def test_calm_air_moves_nothing():
    assert Windblown.of(0.0, CARRIER_HZ).field_correlation(np.array([1e6])) == 1.0


@pytest.mark.parametrize("wind_mps", [3.0, 10.0])
def test_waves_are_as_high_as_their_fetch_lets_them_grow(wind_mps):
    """Hasselmann and others 1973: the significant height is 0.0016 U sqrt(F / g)."""
    rate = np.linspace(0.5, 12, 20_000) * peak_rate(wind_mps, 1000.0)
    variance = np.trapezoid(jonswap(rate, wind_mps, 1000.0), rate)
    assert 4 * np.sqrt(variance) == pytest.approx(0.0016 * wind_mps * np.sqrt(1000.0 / gravity), rel=0.2)


def test_drawn_waves_have_the_variance_and_the_orbital_speed_of_the_spectrum():
    time_s = np.random.default_rng(2).uniform(0, 1e5, 20_000)
    place = np.random.default_rng(3).uniform(-500, 500, (len(time_s), 3))
    offset, velocity = Waves.of(WIND, 1000.0, 1).moved(place, time_s)
    highest = np.sqrt(2 * np.pi * gravity / 0.1)
    rate = np.linspace(0.5 * peak_rate(10.0, 1000.0), highest, 20_000)
    spectrum = jonswap(rate, 10.0, 1000.0)
    assert offset[:, 2].var() == pytest.approx(np.trapezoid(spectrum, rate), rel=0.15)
    assert velocity[:, 2].var() == pytest.approx(np.trapezoid(rate**2 * spectrum, rate), rel=0.15)
    # Orbits in deep water are circles; with cos^2 about the wind three quarters of the level part lie along it.
    level = velocity[:, :2] @ np.column_stack([WIND / 10, [-WIND[1] / 10, WIND[0] / 10]])
    assert level.var(axis=0).sum() == pytest.approx(velocity[:, 2].var(), rel=0.05)
    assert level[:, 0].var() / velocity[:, 2].var() == pytest.approx(0.75, abs=0.12)


def test_velocities_are_those_of_the_surface():
    waves, place = Waves.of(WIND, 300.0, 4), np.array([[12.0, -7.0, 3.0]])
    before, after = (waves.moved(place, np.array([50.0 + step]))[0] for step in (-1e-4, 1e-4))
    np.testing.assert_allclose((after - before) / 2e-4, waves.moved(place, np.array([50.0]))[1], rtol=1e-5)


def test_ripples_run_at_the_phase_speed_of_gravity_and_tension():
    """Two lines, as strong as the angle to the wind has it: 150 Hz at 45 deg, where tension rules."""
    waves, wavelength_m = Waves.of(WIND, 1000.0, 1), 3.9e-3
    number = np.random.default_rng(5).random(10_000)
    down = -np.sqrt(0.5)
    upwind, across = (np.array([*(np.sqrt(0.5) * np.array(way)), down]) for way in ((-0.6, -0.8), (0.8, -0.6)))
    wave_per_m = 4 * np.pi / wavelength_m * np.sqrt(0.5)
    expected = np.sqrt(gravity * wave_per_m + TENSION_M3_PER_S2 * wave_per_m**3) / (2 * np.pi)
    assert 140 < expected < 160
    against = waves.ripple_hz(np.tile(upwind, (len(number), 1)), number, wavelength_m)
    np.testing.assert_allclose(against, expected)  # the wind blows them toward a radar that looks against it
    beside = waves.ripple_hz(np.tile(across, (len(number), 1)), number, wavelength_m)
    np.testing.assert_allclose(np.abs(beside), expected)
    assert np.mean(beside > 0) == pytest.approx(0.5, abs=0.02)
