"""Beat synthesis against the plain sum of the exact phase, sample by sample and path by path."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beams import make_chirp
from direct_receiver import C, points_at
from flights import make_pulses
from plain_beats import SWEEPS, plain_sum, random_paths, relative_error
from sionna_radar.signal import beat as beat_module
from sionna_radar.signal.beat import synthesise
from sionna_radar.signal.beat_sum import exponential_sums
from sionna_radar.tracing.paths import Paths


@pytest.mark.parametrize(("sweep", "sampling"), SWEEPS)
@pytest.mark.parametrize("rate_mps", [0.0, 14.0, -14.0])
def test_one_velocity_is_exact(sweep, sampling, rate_mps):
    chirp = make_chirp(sweep=sweep, sampling=sampling)
    paths, pulses = random_paths(1, 60, 4, (rate_mps, rate_mps)), make_pulses(4, first=10)
    assert relative_error(synthesise(paths, pulses, chirp), plain_sum(paths, pulses.index, chirp)) < 1e-6


@pytest.mark.parametrize(("sweep", "sampling"), SWEEPS)
def test_a_wide_spread_of_velocities_converges_to_the_plain_sum(monkeypatch, sweep, sampling):
    chirp = make_chirp(sweep=sweep, sampling=sampling)
    paths, pulses = random_paths(2, 60, 4, (-15.0, 15.0)), make_pulses(4, first=10)
    monkeypatch.setattr(beat_module, "DRIFT_ACCURACY", 1e-9)
    assert relative_error(synthesise(paths, pulses, chirp), plain_sum(paths, pulses.index, chirp)) < 1e-6


@pytest.mark.parametrize(("sweep", "sampling"), SWEEPS)
@pytest.mark.parametrize("spread_mps", [0.3, 3.0, 15.0, 60.0])
def test_the_drift_series_is_as_accurate_as_it_promises(sweep, sampling, spread_mps):
    chirp = make_chirp(sweep=sweep, sampling=sampling)
    paths, pulses = random_paths(3, 300, 4, (-spread_mps, spread_mps)), make_pulses(4, first=10)
    expected = plain_sum(paths, pulses.index, chirp)
    error = synthesise(paths, pulses, chirp) - expected
    assert np.sqrt(np.mean(np.abs(error) ** 2) / np.mean(np.abs(expected) ** 2)) < beat_module.DRIFT_ACCURACY


@settings(max_examples=25)
@given(st.integers(0, 10**6), st.integers(0, 20), st.integers(0, 20), st.floats(-20, 20))
def test_scatterers_superpose(seed, one, other, rate_mps):
    chirp, pulses = make_chirp(samples=256), make_pulses(3, first=10)
    parts = [random_paths(seed + k, count, 3, (rate_mps, rate_mps)) for k, count in enumerate((one, other))]
    together = synthesise(Paths.concatenate(parts), pulses, chirp)
    apart = sum(synthesise(part, pulses, chirp) for part in parts)
    np.testing.assert_allclose(together, apart, atol=1e-6 * 1e-6 * (one + other + 1))


@settings(max_examples=25)
@given(st.complex_numbers(min_magnitude=1e-9, max_magnitude=1.0), st.floats(0, 2 * np.pi))
def test_a_factor_on_all_gains_is_a_factor_on_the_beat(factor, turn):
    chirp, pulses = make_chirp(samples=128, sampling="iq"), make_pulses(1)
    paths = points_at([5.0, 12.0, 12.5], np.exp(1j * turn) * np.array([1.0, 2.0, 3.0j]))
    scaled = points_at([5.0, 12.0, 12.5], factor * paths.gain)
    expected = np.conj(factor) * synthesise(paths, pulses, chirp)
    np.testing.assert_allclose(synthesise(scaled, pulses, chirp), expected, atol=1e-6 * abs(factor))


@pytest.mark.parametrize(("sweep", "sampling"), SWEEPS)
def test_a_path_of_gain_a_brings_the_power_a_squared(sweep, sampling):
    chirp = make_chirp(sweep=sweep, sampling=sampling)
    beat = synthesise(points_at(60.0, 3e-5 * np.exp(0.7j)), make_pulses(1), chirp)
    assert np.isrealobj(beat) == (sampling == "real")
    assert np.mean(np.abs(beat) ** 2) == pytest.approx(9e-10, rel=5e-3)


@pytest.mark.parametrize(("sweep", "sampling"), SWEEPS)
def test_range_reads_as_a_positive_frequency(sweep, sampling):
    chirp = make_chirp(sweep=sweep, sampling=sampling)
    beat = synthesise(points_at(60.0), make_pulses(1), chirp)[0]
    spectrum = np.abs(np.fft.fft(beat))
    half = spectrum[:512] if sampling == "real" else spectrum
    assert np.argmax(half) == round(60.0 * 2 * 500e6 / C)


@pytest.mark.parametrize(
    ("sampling", "kept"), [("real", [True, True, False, False]), ("iq", [True, True, True, False])]
)
def test_beats_beyond_the_sampling_are_filtered_out(sampling, kept):
    chirp, pulses = make_chirp(sampling=sampling), make_pulses(1)
    for range_m, passed in zip((20.0, 153.0, 155.0, 310.0), kept, strict=True):
        beat = synthesise(points_at(range_m), pulses, chirp)
        assert np.any(beat != 0) == passed, range_m


def test_pulses_without_paths_are_silent():
    pulses = make_pulses(4, first=10)
    beat = synthesise(points_at([50.0, 60.0], pulse=[11, 13]), pulses, make_chirp())
    np.testing.assert_array_equal(np.any(beat != 0, axis=1), [False, True, False, True])
    assert not np.any(synthesise(points_at([]), pulses, make_chirp()))


def test_the_block_changes_no_bit():
    chirp, paths = make_chirp(), random_paths(5, 20_000, 40, (-3.0, 3.0))
    whole = synthesise(paths, make_pulses(40, first=10), chirp)
    for k in (10, 23, 49):
        alone = paths.rows(paths.pulse == k)
        np.testing.assert_array_equal(synthesise(alone, make_pulses(1, first=k), chirp)[0], whole[k - 10])


@pytest.mark.parametrize("samples", [16, 255, 1024])
def test_the_sums_are_those_written_out(samples):
    random = np.random.default_rng(1)
    first = np.array([0, 40, 40, 90])
    last = np.array([40, 40, 90, 91])
    frequency = np.concatenate([random.uniform(-2, 2, 89), [0.0, 0.5]])
    weight = random.normal(size=91) + 1j * random.normal(size=91)
    bend = np.array([0.0, 1e-6, -2e-7, 1e-5])
    number = np.arange(samples) - samples // 2
    found = exponential_sums(first, last, frequency, weight, bend, samples)
    for row, (a, b) in enumerate(zip(first, last, strict=True)):
        cycles = np.outer(number, frequency[a:b]) + bend[row] * number[:, None] ** 2
        expected = np.exp(2j * np.pi * cycles) @ weight[a:b]
        np.testing.assert_allclose(found[row], expected, atol=1e-7 * np.sqrt(max(b - a, 1)))
