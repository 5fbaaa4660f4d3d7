"""The power scale of the spectrum, and what its window does to noise."""

import numpy as np
import pytest

from beams import make_chirp
from sionna_radar.detection.spectrum import SpectrumAnalyser

C = 299_792_458.0


def tone(chirp, cycles: float, power: float, phase: float = 0.4) -> np.ndarray:
    """A beat of a given power with so many cycles over the sweep."""
    turn = 2 * np.pi * cycles * np.arange(chirp.samples) / chirp.samples + phase
    return np.sqrt(power) * (np.exp(1j * turn) if chirp.sampling == "iq" else np.sqrt(2) * np.cos(turn))


@pytest.mark.parametrize("zero_padding", [1, 2, 4])
@pytest.mark.parametrize("window", ["hann", "blackman", "boxcar"])
@pytest.mark.parametrize("sampling", ["real", "iq"])
def test_a_tone_of_power_p_peaks_at_p(sampling, window, zero_padding):
    chirp = make_chirp(sampling=sampling)
    spectrum = SpectrumAnalyser(chirp, window, zero_padding).power(tone(chirp, 200, 2.5e-9)[None])[0]
    assert np.argmax(spectrum) == 200 * zero_padding
    assert 10 * np.log10(spectrum.max() / 2.5e-9) == pytest.approx(0.0, abs=0.01)


def test_a_tone_between_bins_loses_the_scalloping_of_its_window():
    chirp = make_chirp()
    # Hann, half a bin off: 1.42 dB (Harris 1978, Table 1).
    spectrum = SpectrumAnalyser(chirp, "hann", 1).power(tone(chirp, 200.5, 1.0)[None])[0]
    assert 10 * np.log10(spectrum.max()) == pytest.approx(-1.42, abs=0.01)


@pytest.mark.parametrize(("sampling", "cells"), [("real", 512), ("iq", 1024)])
def test_the_range_axis_covers_what_the_sampling_can_tell(sampling, cells):
    analyser = SpectrumAnalyser(make_chirp(sampling=sampling), "hann", 2)
    assert len(analyser.range_m) == 2 * cells
    np.testing.assert_allclose(analyser.range_m, np.arange(2 * cells) * C / 2e9, rtol=1e-12)
    assert analyser.power(np.zeros((3, 1024))).shape == (3, 2 * cells)


@pytest.mark.parametrize("sampling", ["real", "iq"])
def test_white_noise_of_power_n_lies_at_n_over_the_windows_gain(sampling):
    chirp = make_chirp(sampling=sampling)
    random = np.random.default_rng(3)
    noise = random.normal(size=(2000, 1024))
    if sampling == "iq":
        noise = (noise + 1j * random.normal(size=noise.shape)) / np.sqrt(2)
    power = SpectrumAnalyser(chirp, "hann", 1).power(noise)[:, 5:-5]
    # Hann: equivalent noise bandwidth 1.5 bins (Harris 1978); a real beat's noise is squeezed into half the bins.
    expected = 1.5 / 1024 * (2 if sampling == "real" else 1)
    assert power.mean() == pytest.approx(expected, rel=0.01)
    assert power.std() == pytest.approx(power.mean(), rel=0.02)  # exponential


def test_noise_correlation_of_the_hann_window():
    # Hann is 1 at lag 0, its square has cosine terms at one and two bins: 2/3 and 1/6.
    correlation = SpectrumAnalyser(make_chirp(), "hann", 2).noise_correlation(6)
    np.testing.assert_allclose(correlation, [1, 2 / 3, 1 / 6, 0, 0, 0], atol=1e-4)


def test_noise_correlation_is_the_measured_one():
    chirp = make_chirp(sampling="iq", samples=128)
    analyser = SpectrumAnalyser(chirp, "blackman", 2)
    random = np.random.default_rng(3)
    noise = random.normal(size=(20_000, 128)) + 1j * random.normal(size=(20_000, 128))
    spectrum = np.fft.fft(noise * analyser.window, 256)
    for lag, expected in enumerate(analyser.noise_correlation(5)):
        product = np.mean(spectrum[:, 100] * np.conj(spectrum[:, 100 + 2 * lag])) / np.mean(
            np.abs(spectrum[:, 100]) ** 2
        )
        assert abs(product) == pytest.approx(abs(expected), abs=0.03)


@pytest.mark.parametrize("window", ["hann", "blackman"])
def test_the_mean_range_of_cells_scatters_about_that_of_their_scatterers(window):
    """That of the scatterers is measured as receivers do it, by the phase of a second signal that grows with range."""
    analyser = SpectrumAnalyser(make_chirp(sampling="iq", samples=128), window, 2)
    random, count, turn = np.random.default_rng(4), 50, 1e-3
    place, cell = np.arange(-12, count + 12, 0.125), np.arange(0, count, 0.5)
    middle = np.arange(128) - 63.5
    heard = np.cos(2 * np.pi * np.subtract.outer(place, cell)[..., None] * middle / 128) @ analyser.window
    field = random.normal(size=(4000, len(place))) + 1j * random.normal(size=(4000, len(place)))
    first, second = field @ heard, (field * np.exp(1j * turn * place)) @ heard
    power = np.abs(first) ** 2
    of_scatterers = np.angle(np.sum(second * first.conj() * np.exp(-1j * turn * count / 2), axis=1)) / turn + count / 2
    off = of_scatterers - power @ cell / power.sum(axis=1)
    looks = count * analyser.looks_per_cell
    assert count * np.std(off) == pytest.approx(analyser.edge_cells * np.sqrt(looks / (looks - 1)), rel=0.15)
