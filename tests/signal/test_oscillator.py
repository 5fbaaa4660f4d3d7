"""The oscillator: phase noise behind the mixer by its spectrum, its power, its distribution and its draws."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import kurtosis, skew

from direct_receiver import points_at
from flights import make_pulses
from sionna_radar.radar.build import build_sweeps
from sionna_radar.scenario.radar import RadarTable
from sionna_radar.scenario.receiver import PHASE_NOISE
from sionna_radar.signal.beat import analytic_beats
from sionna_radar.signal.build import build_chain
from sionna_radar.signal.oscillator import PhaseNoise
from sionna_radar.signal.receiver import Receiver

# Low enough for the square of the phase, which spreads over all offsets, to stay under what is tested.
LEVELS = ((1e3, -85.0), (1e4, -90.0), (1e5, -100.0), (1e6, -110.0), (1e7, -130.0))
C = 299_792_458.0
# 4.1 ms at 4 MHz: side bands from 1 kHz to 1 MHz around an echo in the middle of the band.
FAST = {"chirp_rate_hz": 4e6 / 2**14, "samples_per_chirp": 2**14, "sampling": "iq", "snr_db": 30.0}
PULSES = 48


def radar_at(range_m: float) -> RadarTable:
    """The radar whose echo from a range has its beat at 2 MHz, a whole number of periods in a sweep."""
    levels = {"oscillator": {"phase_noise_dbc_hz": LEVELS}}
    return RadarTable(**FAST, bandwidth_hz=2e6 * C / (2 * range_m * FAST["chirp_rate_hz"]), receiver=levels)


@pytest.mark.parametrize("range_m", [40.0, 100.0, 400.0])
def test_the_side_bands_of_an_echo_are_those_of_theory_from_1_khz_to_1_mhz(range_m):
    """4 sin^2(pi f tau) L(f) on either side, within 0.5 dB in each of seven bands of frequency."""
    radar = radar_at(range_m)
    sweeps = build_sweeps(radar)
    receiver = Receiver(
        sweeps=sweeps, transmit_power_w=1.0, noise_power_w=0.0, seed=2, chain=build_chain(radar, sweeps, None)
    )
    paths, pulses = points_at(np.full(PULSES, range_m), pulse=np.arange(PULSES)), make_pulses(PULSES)
    echo = receiver.beat(paths, pulses)
    chirp = receiver.chirp
    clean = analytic_beats(paths, pulses, chirp)
    # The echo without its carrier: what phase noise leaves around it.
    window = np.hanning(chirp.samples)
    left = np.fft.fft((echo / clean - 1) * window, axis=1)
    density = np.mean(np.abs(left) ** 2, axis=0) / (np.sum(window**2) * chirp.sampling_rate_hz)
    offset = np.fft.fftfreq(chirp.samples, 1 / chirp.sampling_rate_hz)
    edges = np.geomspace(1e3, 1e6, 8)
    noise = PhaseNoise(LEVELS)
    for sign in (1, -1):
        for low, high in pairwise(edges):
            band = (sign * offset >= low) & (sign * offset < high)
            f = np.abs(offset[band])
            theory = 4 * np.sin(np.pi * f * 2 * range_m / C) ** 2 * noise.density(f)
            clear = theory > 1e-3 * theory.max()  # but for the zeros of the sine, where the window's neighbours show
            assert abs(10 * np.log10(np.mean((density[band] / theory)[clear]))) < 0.5


def test_the_phase_has_the_power_of_its_levels_and_is_gaussian():
    noise = PhaseNoise(((1e3, -80.0), (1e4, -80.0), (1e6, -100.0)))
    waves = noise.waves(1, np.arange(300), 2048, 2e6)
    late = waves.difference(1.0, np.arange(300))  # a delay of whole periods but one in many: two phases apart
    delay = 3.3e-4
    phase = waves.difference(delay, np.arange(300))
    f = waves.offset_hz[1:-1]
    expected = np.sum(2 * 4 * np.sin(np.pi * f * delay) ** 2 * noise.density(f)) * f[0]
    assert np.mean(phase**2) == pytest.approx(expected, rel=0.03)
    assert late.shape == phase.shape == (300, 2048)
    # Phases a period of the slowest wave apart are drawn anew.
    apart = phase[:, ::512] / np.sqrt(expected)
    assert abs(skew(apart.ravel())) < 4 * np.sqrt(6 / apart.size)
    assert abs(kurtosis(apart.ravel())) < 4 * np.sqrt(24 / apart.size)


def test_the_floor_far_from_an_echo_is_the_integral_of_the_levels():
    """Far beyond 1 / tau the mean of 4 sin^2 is 2: a flat level L leaves 2 L f_s of the echo's power in f_s."""
    noise = PhaseNoise(((1.0, -90.0),))
    waves = noise.waves(1, np.arange(200), 4096, 1e6)
    phase = waves.difference(1.2345e-3, np.arange(200))
    assert np.mean(phase**2) == pytest.approx(2 * 1e-9 * 1e6, rel=0.02)


def test_a_delay_shorter_than_a_sample_is_no_approximation():
    waves = PhaseNoise(LEVELS).waves(1, np.arange(2), 256, 1e6)
    t = np.arange(256) / 1e6
    for delay in (1e-9, 3.3e-8, 1.7e-6):
        turn = 1j * 2 * np.pi * waves.offset_hz
        summed = 2 * ((waves.amplitude * (1 - np.exp(-turn * delay))) @ np.exp(np.outer(turn, t))).real
        np.testing.assert_allclose(waves.difference(delay, np.arange(2)), summed, atol=1e-12 * np.abs(summed).max())


def test_a_pulse_and_a_sweep_have_their_own_phase():
    noise = PhaseNoise(LEVELS)
    first = noise.waves(1, np.array([7]), 64, 1e6).amplitude
    np.testing.assert_array_equal(noise.waves(1, np.arange(10), 64, 1e6).amplitude[7], first[0])
    others = (noise.waves(2, np.array([7]), 64, 1e6), noise.waves(1, np.array([7]), 64, 1e6, 1))
    for other in others:
        assert not np.any(other.amplitude[0, 1:-1] == first[0, 1:-1])


def test_levels_between_below_and_beyond_those_given():
    density = PhaseNoise(((1e4, -80.0), (1e5, -100.0))).density(np.array([0.0, 1e3, 1e4, 10**4.5, 1e5, 1e7]))
    np.testing.assert_allclose(10 * np.log10(density[1:]), [-60.0, -80.0, -90.0, -100.0, -100.0])
    assert density[0] == 0


def test_published_phase_noise_has_the_figure_of_its_source():
    for preset in PHASE_NOISE.values():
        level = 10 * np.log10(PhaseNoise(preset.levels).density(np.array([1e6]))[0])
        assert f"{level:.0f} dBc/Hz at 1 MHz" in preset.source
        assert preset.assumed


def test_a_steep_table_has_a_number_below_its_first_offset():
    steep = PhaseNoise(((1e6, 0.0), (1.001e6, -250.0))).density(np.geomspace(1.0, 1e8, 30))
    assert np.all(np.isfinite(steep))
