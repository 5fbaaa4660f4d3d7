"""Chirps a second: of the CPU, and of a GPU beside it where there is one."""

import pytest

import benchmark_cases


def test_a_chirp_takes_time():
    assert 0 < benchmark_cases.chirps_a_second("hills", "per_pulse", 24) < 1e6


@pytest.mark.parametrize("usable", [False, True])
def test_a_gpu_is_held_against_the_cpu_where_there_is_one(monkeypatch, usable):
    monkeypatch.setattr(benchmark_cases, "gpu_usable", lambda: usable)
    speed = {"llvm": 2000.0, "cuda": 9000.0}
    monkeypatch.setattr(benchmark_cases, "_in_process", lambda backend, *_: speed[backend])
    found = list(benchmark_cases.measure_backends(8))
    assert len(found) == benchmark_cases.backend_ratios()
    assert all(ratio.kept for ratio in found)
    assert {ratio.value for ratio in found if ratio.name.endswith("GPU / CPU")} == ({4.5} if usable else set())
    assert {ratio.value for ratio in found if ratio.name.endswith(" CPU") and "/" not in ratio.name} == {2000.0}
