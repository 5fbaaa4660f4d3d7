"""Stated range errors of weak echoes of points: none below the Cramer-Rao bound, and errors as large as stated."""

from functools import cache

import numpy as np
import pytest

from sionna_radar import load_scenario
from sionna_radar.survey.preparation import prepare

COUNT = 4000


@cache
def detector(ranging, window):
    keys = {"platform.length_m": 10.0, "processing.ranging": ranging, "processing.window": window}
    return prepare(load_scenario("hills", keys)).instrument.detector


@cache
def weak_tones(ranging, window, peak_snr_db):
    """Return errors (m), stated errors (m), bins of the spans, and the bound (m) of tones of a mean SNR at their peak.

    For a real tone of amplitude A in white noise s over N samples, of unknown phase, the frequency in cycles has the
    variance 24 s^2 / (4 pi^2 A^2 N) at least (Rife and Boorstyn 1974, eq. 17, halved power); no window does better.
    """
    found = detector(ranging, window)
    cell_m = found.analyser.chirp.range_resolution_m
    rng, samples, taper = np.random.default_rng(7), found.analyser.chirp.samples, found.analyser.window
    range_m, phase = rng.uniform(60.0, 80.0, (COUNT, 1)), rng.uniform(0.0, 2 * np.pi, (COUNT, 1))
    noise = np.sqrt(0.25 * taper.sum() ** 2 / (np.sum(taper**2) * 10 ** (peak_snr_db / 10)))
    tone = np.cos(2 * np.pi * range_m / cell_m * np.arange(samples) / samples + phase)
    spans = found.spans(found.spectra(tone + noise * rng.standard_normal(tone.shape)))
    ranges = found.estimator(spans)
    error_m = ranges.range_m - range_m[spans.row, 0]
    near = np.abs(error_m) < 3.0  # others are false alarms
    bound_m = cell_m * np.sqrt(24 * noise**2 / samples) / (2 * np.pi)
    return error_m[near], ranges.sigma_m[near], (spans.stop - spans.start)[near], bound_m


@pytest.mark.parametrize("ranging", ["centroid", "peak", "model_fit"])
@pytest.mark.parametrize("window", ["hann", "blackman"])
@pytest.mark.parametrize("peak_snr_db", [11.0, 12.0, 13.0, 16.0])
def test_no_weak_echo_states_less_than_the_cramer_rao_bound(ranging, window, peak_snr_db):
    error_m, sigma_m, _, bound_m = weak_tones(ranging, window, peak_snr_db)
    assert len(sigma_m) > 100
    assert sigma_m.min() > bound_m
    assert error_m.std() > bound_m
    assert np.mean((error_m / sigma_m) ** 2) < 1.0


@pytest.mark.parametrize("ranging", ["centroid", "peak"])
def test_an_echo_of_a_single_bin_lies_anywhere_in_it(ranging):
    """The bins are 0.15 m, so a uniform error has 0.043 m; the noise adds to it."""
    tones = [weak_tones(ranging, "hann", peak_snr_db) for peak_snr_db in (11.0, 12.0, 13.0)]
    error_m, sigma_m, bins = (np.concatenate([tone[n] for tone in tones]) for n in range(3))
    assert (bins == 1).sum() > 40
    assert sigma_m[bins == 1] == pytest.approx(detector(ranging, "hann").analyser.bin_m / np.sqrt(12))
    assert np.sqrt(np.mean(error_m[bins == 1] ** 2)) == pytest.approx(0.043, rel=0.3)
