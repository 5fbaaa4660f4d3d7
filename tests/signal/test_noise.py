"""Thermal noise: its power, its independence, and where the power comes from."""

import numpy as np
import pytest

from sionna_radar.radar.chirp import build_chirp
from sionna_radar.scenario.radar import RadarTable
from sionna_radar.signal.receiver import add_noise, noise_power, transmit_power_w

POWER = 3e-13


@pytest.mark.parametrize("kind", [float, complex])
def test_noise_has_the_wanted_power(kind):
    noise = add_noise(np.zeros((400, 1024), dtype=kind), POWER, 1, np.arange(400))
    count = noise.size * (2 if kind is complex else 1)
    assert np.mean(np.abs(noise) ** 2) == pytest.approx(POWER, rel=4 * np.sqrt(2 / count))
    assert abs(noise.mean()) < 4 * np.sqrt(POWER / noise.size)
    if kind is complex:
        assert noise.real.var() == pytest.approx(noise.imag.var(), rel=0.02)
        assert abs(np.mean(noise**2)) < 4 * POWER / np.sqrt(noise.size)  # circular


@pytest.mark.parametrize("kind", [float, complex])
def test_noise_is_white(kind):
    noise = add_noise(np.zeros((500, 512), dtype=kind), 1.0, 1, np.arange(500))
    for lag in (1, 2, 7):
        assert abs(np.mean(noise[:, lag:] * np.conj(noise[:, :-lag]))) < 4 / np.sqrt(noise.size)
    assert abs(np.mean(noise[1:] * np.conj(noise[:-1]))) < 4 / np.sqrt(noise.size)


def test_noise_belongs_to_the_pulse_and_the_seed():
    silent = np.zeros((20, 64))
    whole = add_noise(silent, 1.0, 5, np.arange(100, 120))
    np.testing.assert_array_equal(add_noise(silent[:1], 1.0, 5, np.array([107]))[0], whole[7])
    assert not np.any(whole == add_noise(silent, 1.0, 6, np.arange(100, 120)))
    assert not np.any(silent)  # the input is left alone


def test_noise_is_added():
    signal = np.linspace(0, 5, 64)[None]
    quiet = add_noise(np.zeros((1, 64)), 1.0, 1, np.array([3]))
    np.testing.assert_allclose(add_noise(signal, 1.0, 1, np.array([3])), signal + quiet)


@pytest.mark.parametrize(("sampling", "bandwidth_hz"), [("real", 184_320), ("iq", 368_640)])
def test_a_noise_figure_gives_k_t_f_b(sampling, bandwidth_hz):
    # k T at 290 K is -173.975 dBm/Hz.
    radar = RadarTable(transmit_power_dbm=10.0, noise_figure_db=12.0, sampling=sampling)
    expected_dbm = -173.975 + 12.0 + 10 * np.log10(bandwidth_hz)
    measured = noise_power(radar, build_chirp(radar), reference_echo=1.0)
    assert 10 * np.log10(measured / 1e-3) == pytest.approx(expected_dbm, abs=1e-3)
    assert transmit_power_w(radar) == pytest.approx(0.01)


def test_twice_the_temperature_is_twice_the_noise():
    cold, hot = (RadarTable(transmit_power_dbm=0.0, noise_figure_db=3.0, temperature_k=t) for t in (150.0, 300.0))
    assert noise_power(hot, build_chirp(hot), 1.0) == pytest.approx(2 * noise_power(cold, build_chirp(cold), 1.0))


def test_a_signal_to_noise_ratio_is_counted_from_the_reference_echo():
    radar = RadarTable(snr_db=30.0)
    assert noise_power(radar, build_chirp(radar), reference_echo=4e-10) == pytest.approx(4e-13)
    assert transmit_power_w(radar) == 1.0
