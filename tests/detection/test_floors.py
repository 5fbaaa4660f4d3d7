"""Floors in closed form against mean spectra of the whole chain."""

from dataclasses import replace

import numpy as np
import pytest

from direct_receiver import points_at
from flights import make_pulses
from receivers import radar_with, receiver_of
from sionna_radar.detection.floors import floors
from sionna_radar.detection.spectrum import SpectrumAnalyser

PULSES = 150
NOISY = {"phase_noise_dbc_hz": [[1e3, -75.0], [1e5, -75.0], [1e6, -95.0]]}
LEAK = [{"delay_ns": 40.0, "level_db": -20.0}]


def measured(radar, noise_w, echo=(0.0, 20.0)):
    receiver = receiver_of(radar, noise_w)
    analyser = SpectrumAnalyser(receiver.chirp, "blackmanharris", 1, receiver.high_pass)
    paths = points_at(np.full(PULSES, echo[1]), np.sqrt(echo[0]), pulse=np.arange(PULSES))
    power = analyser.power(receiver.beat(paths, make_pulses(PULSES))).mean(axis=0)
    return power, floors(radar, analyser, noise_w, *echo), analyser


def compare(power, expected, cells, tolerance_db=0.5):
    """Mean over stretches of cells, whose scatter is under a third of the tolerance."""
    for stretch in np.array_split(cells, 4):
        ratio = np.mean(power[stretch] / expected[stretch])
        assert abs(10 * np.log10(ratio)) < tolerance_db


@pytest.mark.parametrize("sampling", ["real", "iq"])
def test_thermal_noise_and_rounding(sampling):
    table = {"converter": {"bits": 5, "full_scale_over_noise_db": 24.0}}
    power, expected, _ = measured(radar_with(table, sampling=sampling), 1e-6)
    # Steps as wide as the noise is, whose rounding is still one of even errors.
    np.testing.assert_allclose(expected.rounding, expected.thermal * 10**2.4 / (1.5 * 4**5))
    compare(power, expected.total, np.arange(4, len(power) - 4), 0.2)


@pytest.mark.parametrize("sampling", ["real", "iq"])
def test_phase_noise_of_a_strong_echo(sampling):
    radar = radar_with({"oscillator": NOISY}, sampling=sampling, samples_per_chirp=512)
    far = 60 * 299_792_458.0 / 2 / 500e6
    power, expected, analyser = measured(radar, 1e-13, (1.0, far))
    at = round(far / analyser.bin_m)
    cells = np.arange(len(power))
    clear = cells[(np.abs(cells - at) > 6) & (cells > 4) & (cells < len(power) - 4)]
    assert np.median(expected.echo_phase[clear] / expected.thermal[clear]) > 30
    compare(power, expected.total, clear)


def test_phase_noise_of_leakage_behind_a_high_pass():
    keys = {"oscillator": NOISY, "leakage": LEAK, "high_pass_corner_hz": 10e3}
    radar = radar_with(keys, samples_per_chirp=512)
    power, expected, _ = measured(radar, 1e-14)
    clear = np.arange(40, 250)
    assert np.median(expected.leakage_phase[clear] / expected.thermal[clear]) > 3
    compare(power, expected.total, clear)


def test_what_is_not_there_has_no_floor():
    analyser = measured(radar_with(), 1e-6)[2]
    found = floors(radar_with(), analyser, 1e-6)
    assert not np.any(found.rounding + found.leakage_phase + found.echo_phase)
    np.testing.assert_array_equal(found.total, found.thermal)
    agc = radar_with({"converter": {"bits": 8, "agc_headroom_db": 3.0}})
    assert not np.any(floors(agc, replace(analyser), 1e-6).rounding)
