"""NumPy files that lie about their size, or are damaged: one error each, and no memory taken."""

import io
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
from numpy.lib import format as npy

from mutants import mutated
from sionna_radar.foundation.errors import InputFileError
from sionna_radar.readers.recordings.numpy_file import stored_arrays

SAMPLES = np.linspace(-1.0, 1.0, 600).reshape(20, 30)
MUTANTS = 200


def header(shape: tuple[int, ...]) -> bytes:
    file = io.BytesIO()
    npy.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return file.getvalue()


def packed(path: Path, content: bytes, zeros: int = 0) -> Path:
    """Write an .npz of one array, with so many bytes of zeros after its header."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("samples.npy", "w") as file:
        file.write(content)
        for start in range(0, zeros, 2**20):
            file.write(bytes(min(2**20, zeros - start)))
    return path


def test_arrays_are_those_that_were_saved(tmp_path):
    np.save(tmp_path / "a.npy", SAMPLES)
    np.savez(tmp_path / "b.npz", samples=SAMPLES, other=np.arange(3))
    np.savez_compressed(tmp_path / "c.npz", samples=SAMPLES[:, ::-1].T)
    found, names = stored_arrays(tmp_path / "a.npy", {"ours": "any"})
    assert (found["ours"] == SAMPLES).all()
    assert names == []
    found, names = stored_arrays(tmp_path / "b.npz", {"ours": "samples", "absent": "none"})
    assert list(found) == ["ours"]
    assert (found["ours"] == SAMPLES).all()
    assert names == ["samples", "other"]
    assert (stored_arrays(tmp_path / "c.npz", {"s": "samples"})[0]["s"] == SAMPLES[:, ::-1].T).all()


@pytest.mark.parametrize(
    ("shape", "zeros", "said"),
    [
        ((3_000_000, 2_000_000_000), 0, "samples has 0 bytes, and 48,000,000,000,000,000 by its header"),
        ((1000, 1001), 8_000_000, "samples has 8,000,000 bytes, and 8,008,000 by its header"),
        ((1000, 1000), 8_000_000, "samples unpacks to 8,000,000 bytes, more than 7,000,000; save it as a .npy file"),
    ],
)
def test_an_array_larger_than_its_file_or_than_memory_is_refused_by_its_header(
    shape, zeros, said, tmp_path, monkeypatch
):
    monkeypatch.setattr("sionna_radar.readers.recordings.numpy_file.MAX_UNPACKED_BYTES", 7_000_000)
    path = packed(tmp_path / "claims.npz", header(shape), zeros)
    tracemalloc.start()
    try:
        with pytest.raises(InputFileError, match=said):
            stored_arrays(path, {"samples": "samples"})
        assert tracemalloc.get_traced_memory()[1] < 2_000_000
    finally:
        tracemalloc.stop()


def test_an_npy_of_petabytes_is_refused(tmp_path):
    (tmp_path / "claims.npy").write_bytes(header((10**6, 10**9)))
    with pytest.raises(InputFileError, match="cannot be read as a NumPy file"):
        stored_arrays(tmp_path / "claims.npy", {"samples": "samples"})


@pytest.mark.parametrize("save", [np.save, np.savez, np.savez_compressed])
def test_a_damaged_file_ends_in_one_error_or_an_array(save, tmp_path):
    path = tmp_path / ("samples.npy" if save is np.save else "samples.npz")
    save(path, **({"arr": SAMPLES} if save is np.save else {"samples": SAMPLES}))
    content, rng, messages = path.read_bytes(), np.random.default_rng(7), []
    for _ in range(MUTANTS):
        path.write_bytes(mutated(content, rng))
        try:
            stored_arrays(path, {"samples": "samples"})
        except InputFileError as error:
            messages.append(str(error))
    assert messages
    assert all(path.name in message for message in messages)
