"""What the benchmark says of engines and focusing: their floors are the same work, and less of it."""

import numpy as np
import pytest

import benchmark_cases
from benchmark_cases import nearest_samples


def test_each_takes_longer_than_its_floor(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(benchmark_cases, "ENGINE_REPEATS", 2)
    ratios = list(benchmark_cases.measure_engines(64))
    assert len(ratios) == benchmark_cases.ENGINE_RATIOS
    # The rays of few pulses are cast in no time at all, or by one core; the others are well above.
    assert all(ratio.value > 0.2 for ratio in ratios)
    assert all(ratio.bound == benchmark_cases.FLOOR_BOUND for ratio in ratios)


def test_the_floor_of_focusing_is_a_back_projection():
    rng = np.random.default_rng(3)
    pixel, apex = rng.uniform(-1, 1, (5, 3)), rng.uniform(9, 12, (7, 3))
    spectra = rng.normal(size=(7, 64)) + 1j * rng.normal(size=(7, 64))
    image, along, reach, bins_per_m, cycles_per_m = np.empty(5, dtype=complex), np.array([1.0, 0, 0]), 0.6, 2.5, 3.7
    nearest_samples(0, 5, pixel, apex, spectra, bins_per_m, cycles_per_m, reach, along, image)
    away = pixel[:, None] - apex
    range_m = np.linalg.norm(away, axis=2)
    lit = np.abs(away @ along) <= reach * range_m
    value = spectra[np.arange(7), (range_m * bins_per_m).astype(int)] * np.exp(2j * np.pi * cycles_per_m * range_m)
    assert 0 < lit.sum() < lit.size
    np.testing.assert_allclose(image, np.where(lit, value, 0).sum(axis=1), rtol=1e-9)
