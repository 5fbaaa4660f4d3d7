"""Finding libLLVM and the Mitsuba variant; each in a process of its own where the choice is made."""

import os
import subprocess
import sys

import pytest

from sionna_radar.errors import BackendError
from sionna_radar.scene import backend


@pytest.fixture(autouse=True)
def _forget_the_choice():
    """Let each test choose anew, and leave the session's own choice as it was."""
    backend.find_llvm.cache_clear()
    yield
    backend.find_llvm.cache_clear()


def test_what_it_runs_on_here():
    report = backend.describe_backend()
    assert report.variant in backend.VARIANTS
    assert report.threads >= 1
    if report.variant.startswith("llvm"):
        assert int(report.llvm.version.split(".")[0]) >= backend.OLDEST_LLVM


def test_a_users_own_library_that_is_no_llvm_is_refused(monkeypatch, tmp_path):
    fake = tmp_path / "libLLVM.so"
    fake.write_bytes(b"not a library")
    monkeypatch.setenv(backend.LLVM_VARIABLE, str(fake))
    with pytest.raises(BackendError, match=rf"{backend.LLVM_VARIABLE} = .*libLLVM.so.*version 17"):
        backend.find_llvm()


def test_without_any_library_the_error_names_the_remedy(monkeypatch):
    monkeypatch.delenv(backend.LLVM_VARIABLE, raising=False)
    monkeypatch.setattr(backend, "_wheel_libraries", list)
    monkeypatch.setattr(backend, "_system_libraries", list)
    for system, remedy in (
        ("Linux", "karellen-llvm-core"),
        ("Darwin", "brew"),
        ("Windows", "installer"),
        ("Plan9", "install"),
    ):
        monkeypatch.setattr(backend.platform, "system", lambda name=system: name)
        with pytest.raises(BackendError, match=remedy):
            backend.find_llvm()


def test_the_wheel_comes_before_the_system(monkeypatch):
    monkeypatch.delenv(backend.LLVM_VARIABLE, raising=False)
    monkeypatch.setattr(backend, "_wheel_libraries", lambda: ["old wheel", "wheel"])
    monkeypatch.setattr(backend, "_system_libraries", lambda: ["system"])
    versions = {"wheel": "19.1.7", "system": "18.1.0"}
    monkeypatch.setattr(backend, "_llvm_version", versions.get)
    assert backend.find_llvm() == backend.LlvmLibrary("wheel", "19.1.7", "wheel karellen-llvm-core")
    backend.find_llvm.cache_clear()
    del versions["wheel"]
    assert backend.find_llvm().origin == "system"


@pytest.mark.parametrize(("major", "usable"), [(16, None), (17, "17.2.3"), (21, "21.2.3")])
def test_old_versions_are_not_used(monkeypatch, major, usable):
    class Library:
        @staticmethod
        def LLVMGetVersion(*parts):
            for part, number in zip(parts, (major, 2, 3), strict=True):
                part._obj.value = number

    monkeypatch.setattr(backend.ctypes, "CDLL", lambda path: Library)
    assert backend._llvm_version("any") == usable


def test_a_library_without_a_version_is_not_used(monkeypatch):
    # libLLVM 14 and 15 lack LLVMGetVersion.
    monkeypatch.setattr(backend.ctypes, "CDLL", lambda path: object())
    assert backend._llvm_version("any") is None


def run(code: str, **environment: str) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=os.environ | environment, check=False
    )


def test_an_unknown_variant_is_refused():
    done = run("from sionna_radar.scene.backend import load_mitsuba; load_mitsuba()", SIONNA_RADAR_VARIANT="scalar_rgb")
    assert done.returncode != 0
    assert "BackendError: SIONNA_RADAR_VARIANT = scalar_rgb is unknown" in done.stderr


def test_drjit_imported_first_is_told_of():
    code = """
import os
os.environ.pop("DRJIT_LIBLLVM_PATH", None)
from sionna_radar.scene import backend
import sys, types
sys.modules["drjit"] = types.ModuleType("drjit")
backend._cuda_usable = lambda: False
backend.find_llvm = lambda: backend.LlvmLibrary("/some/libLLVM.so", "19.1", "wheel karellen-llvm-core")
try:
    backend.load_mitsuba()
except backend.BackendError as error:
    print(error)
"""
    assert "set DRJIT_LIBLLVM_PATH=/some/libLLVM.so" in run(code).stdout
