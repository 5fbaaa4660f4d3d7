"""Beat signals summed in the memory of the ray tracer, against the plain sum; their spectra by another library."""

import sys
from types import ModuleType

import numpy as np
import pytest
import scipy.fft

from beams import make_chirp
from direct_receiver import points_at
from flights import make_pulses
from plain_beats import SWEEPS, plain_sum, random_paths, relative_error
from sionna_radar.detection.spectrum import HOST, SpectrumAnalyser, gpu_library
from sionna_radar.signal.device_beats import device_beats
from sionna_radar.tracing.paths import DevicePaths, Paths
from sionna_radar.tracing.sionna.material import mi

PULSES, FIRST = 5, 10
# Single precision, of phases within a turn and of gains.
ACCURACY = 5e-6


def on_device(paths: Paths, pulses, parts: int = 1) -> DevicePaths:
    """Return paths in the memory of the ray tracer, those of each pulse dealt out to a number of parts."""
    dealt = [paths.rows(np.flatnonzero(np.arange(len(paths)) % parts == part)) for part in range(parts)]
    begins = np.cumsum([0, *(len(part) for part in dealt)])
    edges = [
        begin + np.searchsorted(part.pulse, np.append(pulses.index, pulses.index[-1] + 1))
        for begin, part in zip(begins, dealt, strict=False)
    ]
    single, columns = np.float32, {name: np.concatenate([getattr(part, name) for part in dealt]) for name in COLUMNS}
    return DevicePaths(
        pulses=pulses,
        spans=tuple((edge[:-1], edge[1:]) for edge in edges),
        delay_s=mi.Float64(columns["delay_s"]),
        range_rate_mps=mi.Float(columns["range_rate_mps"].astype(single)),
        gain=mi.Complex2f(
            *(np.ascontiguousarray(g, dtype=single) for g in (columns["gain"].real, columns["gain"].imag))
        ),
        paths=paths,
    )


COLUMNS = ("delay_s", "range_rate_mps", "gain")


def fetched(tensor, sampling: str) -> np.ndarray:
    found = HOST.taken(tensor)
    return found[..., 0] + 1j * found[..., 1] if sampling == "iq" else found


@pytest.mark.parametrize("parts", [1, 2])
@pytest.mark.parametrize(("sweep", "sampling"), SWEEPS)
def test_every_sample_is_the_plain_sum(sweep, sampling, parts):
    chirp, pulses = make_chirp(sweep=sweep, sampling=sampling), make_pulses(PULSES, first=FIRST)
    paths = random_paths(3, 40, PULSES, (-20.0, 20.0))
    expected = plain_sum(paths, pulses.index, chirp)
    found = fetched(device_beats(on_device(paths, pulses, parts), chirp), sampling)
    assert found.shape == expected.shape
    assert relative_error(found, expected) < ACCURACY


@pytest.mark.parametrize("sampling", ["real", "iq"])
def test_beats_outside_the_band_and_pulses_without_paths_are_silent(sampling):
    chirp, pulses = make_chirp(sampling=sampling), make_pulses(4, first=FIRST)
    paths = points_at([50.0, 310.0, 60.0], pulse=[10, 11, 13])
    found = fetched(device_beats(on_device(paths, pulses), chirp), sampling)
    np.testing.assert_array_equal(np.any(found != 0, axis=1), [True, False, False, True])
    assert not np.any(fetched(device_beats(on_device(points_at([]), pulses), chirp), sampling))


@pytest.mark.parametrize("sampling", ["real", "iq"])
def test_spectra_are_the_same_by_a_library_that_shares_the_memory(monkeypatch, sampling):
    """CuPy's way, by NumPy's functions under CuPy's names."""
    cupy, scipy_of_it = ModuleType("cupy"), ModuleType("cupyx.scipy")
    cupy.asarray, cupy.from_dlpack, cupy.asnumpy = np.asarray, np.from_dlpack, np.copy
    scipy_of_it.fft = scipy.fft
    modules = {"cupy": cupy, "cupyx": ModuleType("cupyx"), "cupyx.scipy": scipy_of_it, "cupyx.scipy.fft": scipy.fft}
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    modules["cupyx"].scipy = scipy_of_it
    library, chirp = gpu_library(), make_chirp(sampling=sampling)
    assert library is not None
    assert library.arrays is cupy
    pulses = make_pulses(PULSES, first=FIRST)
    tensor = device_beats(on_device(random_paths(4, 40, PULSES, (0.0, 0.0)), pulses), chirp)
    beat, analyser = fetched(tensor, sampling), SpectrumAnalyser(chirp, "hann", 4)
    shared = library.taken(tensor)
    shared = shared[..., 0] + 1j * shared[..., 1] if sampling == "iq" else shared
    np.testing.assert_array_equal(shared, beat)
    found = analyser.power_on_device(shared, library)
    np.testing.assert_allclose(found, analyser.power(beat.astype(np.complex128 if sampling == "iq" else float)))


def test_without_cupy_there_is_no_library_of_a_gpu(monkeypatch):
    monkeypatch.setitem(sys.modules, "cupy", None)
    assert gpu_library() is None
