"""The mean of a burst: what it does to echoes on and beside the beam's axis, and to noise."""

import numpy as np
import pytest

from plain_beats import mover_beats
from sionna_radar.detection.preprocessing import burst_mean
from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.radar.chirp import Chirp

CHIRPS, AXIS_MPS = 8, -6.3


def make_chirp(sampling="iq", sweep="up") -> Chirp:
    values = {"carrier_hz": 77e9, "bandwidth_hz": 500e6, "rate_hz": 4000.0, "samples": 512}
    return Chirp(**values, sampling=sampling, sweep=sweep)


def burst_of(chirp, range_rate_mps, range_m=55.3):
    """Beat signals of a scatterer in each chirp of a burst, and their times from its middle."""
    offset_s = (np.arange(CHIRPS) - (CHIRPS - 1) / 2) / chirp.rate_hz
    return mover_beats(chirp, offset_s, range_m, range_rate_mps), offset_s


@pytest.mark.parametrize(("sampling", "sweep"), [("iq", "up"), ("iq", "down"), ("real", "up"), ("real", "down")])
@pytest.mark.parametrize("beside_mps", [0.0, 0.1, 0.25, -0.4])
def test_an_echo_keeps_what_the_sum_of_its_doppler_leaves(sampling, sweep, beside_mps):
    chirp = make_chirp(sampling, sweep)
    beat, offset_s = burst_of(chirp, AXIS_MPS + beside_mps)
    analyser = SpectrumAnalyser(chirp, "hann", 4)
    found = analyser.power(burst_mean(beat, chirp, offset_s, np.array([AXIS_MPS])))[0].max()
    single = analyser.power(beat[:1])[0].max()
    turn = np.pi * 2 * beside_mps / chirp.wavelength_m / chirp.rate_hz
    expected = 1.0 if beside_mps == 0 else (np.sin(CHIRPS * turn) / (CHIRPS * np.sin(turn))) ** 2
    assert 10 * np.log10(found / single / expected) == pytest.approx(0.0, abs=0.05)


@pytest.mark.parametrize("sampling", ["iq", "real"])
def test_noise_falls_by_the_number_of_chirps(sampling):
    chirp, random = make_chirp(sampling), np.random.default_rng(3)
    bursts = 400
    noise = random.standard_normal((bursts * CHIRPS, chirp.samples))
    if sampling == "iq":
        noise = (noise + 1j * random.standard_normal(noise.shape)) / np.sqrt(2)
    _, offset_s = burst_of(chirp, 0.0)
    analyser = SpectrumAnalyser(chirp, "hann", 1)
    rate_mps = random.uniform(-10, 10, bursts)
    gain = analyser.power(noise).mean() / analyser.power(burst_mean(noise, chirp, offset_s, rate_mps)).mean()
    assert 10 * np.log10(gain / CHIRPS) == pytest.approx(0.0, abs=0.1)
