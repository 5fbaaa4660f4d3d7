"""Filters in front of the converter: what folds, how noise folds, and the direct computation of all of it."""

import numpy as np
import pytest
import scipy.signal

from direct_receiver import direct_beat, points_at
from flights import make_pulses
from receivers import radar_with, receiver_of
from sionna_radar.signal.beat import SampleGrid


def line(beat, cell):
    return np.abs(np.sum(beat * np.exp(-2j * np.pi * cell * np.arange(len(beat)) / len(beat)))) ** 2 / len(beat) ** 2


@pytest.mark.parametrize("order", [2, 4, 6])
@pytest.mark.parametrize("sampling", ["real", "iq"])
def test_what_lies_beyond_the_band_folds_into_it_weakened(sampling, order):
    band_cells = 256 if sampling == "iq" else 128
    corner_hz = 100 * 360.0
    receiver = receiver_of(
        radar_with({"anti_alias_corner_hz": corner_hz, "anti_alias_order": order}, sampling=sampling)
    )
    chirp = receiver.chirp
    for cell in (band_cells // 4, band_cells + 40):
        (beat,) = receiver.beats(points_at(cell * chirp.range_resolution_m), make_pulses(1))
        folded = cell if cell < band_cells else cell - 256 if sampling == "iq" else 256 - cell
        counted_hz = 360.0 * abs(cell - (128 if sampling == "iq" else 0))
        expected = 1 / (1 + (counted_hz / corner_hz) ** (2 * order))
        found = line(beat[0], folded) * (2 if sampling == "real" else 1)
        assert found == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize(("cell", "folded"), [(-20, 236), (360, 104), (480, None)])
def test_complex_samples_see_a_band_around_their_middle(cell, folded):
    """Twice as many points as samples hold beats from -128 to 384 cells; what lies beyond them does not fold twice."""
    corner_hz, order = 40 * 360.0, 4
    radar = radar_with({"anti_alias_corner_hz": corner_hz, "anti_alias_order": order}, sampling="iq")
    receiver = receiver_of(radar)
    assert receiver.chain.oversampling == 2
    chirp = receiver.chirp
    # Negative beats are those of what comes nearer, fast.
    rate_mps = min(cell, 0) * 360.0 * chirp.wavelength_m / 2
    paths = points_at(max(cell, 0) * chirp.range_resolution_m + 1e-9, 1.0, rate_mps)
    (beat,) = receiver.beats(paths, make_pulses(1))
    expected = 0.0 if folded is None else 1 / (1 + (360.0 * (cell - 128) / corner_hz) ** (2 * order))
    found = np.mean(np.abs(beat) ** 2) if folded is None else line(beat[0], folded)
    assert found == pytest.approx(expected, rel=2e-2, abs=1e-12)


@pytest.mark.parametrize("bent", [{}, {"sinusoidal_hz": 1e5, "sinusoidal_periods": 9.0}])
def test_filters_do_what_they_do_in_time(bent):
    """The direct beat at 64 points a sample, through digital filters that hardly differ from the analogue ones."""
    corner_hz, order, fine = 30e3, 3, 64
    keys = {"anti_alias_corner_hz": corner_hz, "anti_alias_order": order, "oscillator": bent}
    radar = radar_with({**keys, "high_pass_corner_hz": 3e3, "high_pass_order": 1})
    receiver = receiver_of(radar)
    paths = points_at([14.0, 33.0, 48.0], [1.0, 0.5j, 2.0])
    found = receiver.beats(paths, make_pulses(1))[0][0]
    grid = SampleGrid(receiver.chirp, fine, 128)
    wide, error = grid.wide, receiver.chain.stages[1].oscillator.error
    given = {} if error is None else {"error_rad": error.phase}
    beat = np.sqrt(2) * direct_beat(paths, wide, wide.sample_time_s, **given).real
    for kind, at, degree in (("lowpass", corner_hz, order), ("highpass", 3e3, 1)):
        sections = scipy.signal.butter(degree, at, kind, fs=wide.sampling_rate_hz, output="sos")
        beat = scipy.signal.sosfilt(sections, beat)
    expected = grid.sampled(beat[None])[0]
    assert np.linalg.norm(found - expected) < 3e-3 * np.linalg.norm(expected)


@pytest.mark.parametrize("sampling", ["real", "iq"])
def test_noise_folds_with_what_the_filter_lets_pass(sampling):
    """The power in a sample is that of the filter's whole response: pi / (2 n sin(pi / 2 n)) of its corner."""
    order, corner_hz = 2, 128 * 360.0
    keys = {"anti_alias_corner_hz": corner_hz, "anti_alias_order": order}
    receiver = receiver_of(radar_with(keys, sampling=sampling), noise_w=2e-6)
    beat = receiver.beats(points_at(20.0, 0.0, pulse=np.arange(400)), make_pulses(400))[0]
    x = np.linspace(0, receiver.chain.oversampling, 20001)
    expected = 2e-6 * np.trapezoid(1 / (1 + x ** (2 * order)), x)
    assert np.mean(np.abs(beat) ** 2) == pytest.approx(expected, rel=0.02)


def test_an_ideal_filter_lets_nothing_fold():
    receiver = receiver_of(radar_with({"oscillator": {"cubic_hz": 1e-6}}))
    far = 160 * receiver.chirp.range_resolution_m
    beat = receiver.beats(points_at(far), make_pulses(1))[0]
    assert np.abs(beat).max() < 2e-3
