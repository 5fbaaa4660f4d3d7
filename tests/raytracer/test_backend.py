"""Finding libLLVM and the Mitsuba variant; each in a process of its own where the choice is made."""

import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from sionna_radar.foundation.errors import BackendError
from sionna_radar.raytracer import backend


@pytest.fixture(autouse=True)
def _forget_the_choice():
    """Let each test choose anew, and leave the session's own choice as it was."""
    backend.find_llvm.cache_clear()
    yield
    backend.find_llvm.cache_clear()


def test_what_it_runs_on_here():
    report = backend.describe_backend()
    assert report.variant in backend.VARIANTS.values()
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


def test_a_wheel_that_does_not_load_is_named_with_the_reason(monkeypatch, tmp_path):
    library = tmp_path / "libLLVM.so"
    library.write_bytes(b"")
    monkeypatch.delenv(backend.LLVM_VARIABLE, raising=False)
    monkeypatch.setattr(backend, "_wheel_libraries", lambda: [library])
    monkeypatch.setattr(backend, "_system_libraries", list)
    with pytest.raises(BackendError, match=rf"The wheel is installed but does not load: .*{library.name}"):
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


def test_an_unknown_backend_is_refused():
    done = run("from sionna_radar.raytracer.backend import load_mitsuba; load_mitsuba()", SIONNA_RADAR_BACKEND="opencl")
    assert done.returncode != 0
    assert (
        "BackendError: backend = opencl (SIONNA_RADAR_BACKEND) is unknown; use one of auto, llvm, cuda" in done.stderr
    )


@pytest.mark.parametrize(
    ("wanted", "gpu", "chosen"),
    [
        (None, True, "cuda"),
        (None, False, "llvm"),
        ("auto", True, "cuda"),
        ("llvm", True, "llvm"),
        ("cuda", True, "cuda"),
    ],
)
def test_the_backend_is_what_was_asked_for_or_a_gpu_where_there_is_one(monkeypatch, wanted, gpu, chosen):
    monkeypatch.setattr(backend, "gpu_usable", lambda: gpu)
    monkeypatch.delenv(backend.BACKEND_VARIABLE, raising=False)
    if wanted:
        monkeypatch.setenv(backend.BACKEND_VARIABLE, wanted)
    assert backend.chosen_backend() == chosen


def test_cuda_without_a_gpu_is_refused_and_leaves_the_choice_as_it_was(monkeypatch):
    monkeypatch.setattr(backend, "gpu_usable", lambda: False)
    monkeypatch.setenv(backend.BACKEND_VARIABLE, "llvm")
    with pytest.raises(backend.BackendError, match="no usable GPU"):
        backend.use_backend("cuda")
    assert backend.chosen_backend() == "llvm"


def test_another_backend_than_the_loaded_one_comes_too_late(monkeypatch):
    monkeypatch.setattr(backend, "gpu_usable", lambda: True)
    monkeypatch.setitem(sys.modules, "mitsuba", SimpleNamespace(variant=lambda: "llvm_ad_mono_polarized"))
    monkeypatch.delenv(backend.BACKEND_VARIABLE, raising=False)
    with pytest.raises(backend.BackendError, match="too late"):
        backend.use_backend("cuda")
    assert backend.BACKEND_VARIABLE not in os.environ


def test_tracing_names_neither_the_cpu_nor_a_gpu():
    """One code serves both: only the backend knows which one it is."""
    for room in ("tracing", "scene", "surfaces", "radar"):
        for path in (Path(backend.__file__).parents[1] / room).rglob("*.py"):
            code = "\n".join(line for line in path.read_text().splitlines() if not line.lstrip().startswith("#"))
            code = code.replace("(libLLVM and the variant must be chosen before these load)", "")
            assert not re.search("llvm|cuda", code, re.IGNORECASE), path


def test_drjit_imported_first_is_told_of():
    code = """
import os
os.environ.pop("DRJIT_LIBLLVM_PATH", None)
from sionna_radar.raytracer import backend
import sys, types
sys.modules["drjit"] = types.ModuleType("drjit")
backend.gpu_usable = lambda: False
backend.find_llvm = lambda: backend.LlvmLibrary("/some/libLLVM.so", "19.1", "wheel karellen-llvm-core")
try:
    backend.load_mitsuba()
except backend.BackendError as error:
    print(error)
"""
    assert "set DRJIT_LIBLLVM_PATH=/some/libLLVM.so" in run(code).stdout


def test_the_wheel_is_found_where_it_was_installed(monkeypatch, tmp_path):
    """For a user, or on PYTHONPATH, it is not under the interpreter's prefix."""
    for name in ("user", "path", "prefix"):
        (tmp_path / name / "lib").mkdir(parents=True)
    monkeypatch.setattr(backend.sys, "prefix", str(tmp_path / "prefix"))
    monkeypatch.setattr(backend.site, "getuserbase", lambda: str(tmp_path / "user"))
    monkeypatch.setattr(backend.sys, "path", [str(tmp_path / "path")])
    recorded = tmp_path / "elsewhere" / "libLLVM.so.19.1"
    recorded.parent.mkdir()
    recorded.touch()

    class Recorded:
        name = recorded.name

        def locate(self):
            return recorded

    monkeypatch.setattr(backend.metadata, "files", lambda name: [Recorded()] if name == backend.WHEEL else None)
    (tmp_path / "user" / "lib" / "libLLVM.so.20.1").touch()
    (tmp_path / "path" / "lib" / "libLLVM.so.18.1").touch()
    assert [path.name for path in backend._wheel_libraries()] == [f"libLLVM.so.{v}.1" for v in (20, 19, 18)]

    def absent(name):
        raise backend.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(backend.metadata, "files", absent)
    assert [path.name for path in backend._wheel_libraries()] == ["libLLVM.so.20.1", "libLLVM.so.18.1"]


@pytest.mark.parametrize(("flushes", "threads"), [(True, 1), (False, 2)])
def test_one_core_is_given_one_thread_if_denormal_numbers_can_be_zero_in_it(monkeypatch, flushes, threads):
    monkeypatch.setattr(backend, "can_flush", lambda: flushes)
    monkeypatch.delenv("SIONNA_RADAR_THREADS", raising=False)
    backend.load_mitsuba()
    import drjit as dr

    before = dr.thread_count()
    dr.set_thread_count(1)
    try:
        backend._use_threads()
        assert dr.thread_count() == threads
    finally:
        dr.set_thread_count(max(before, 2))


def test_a_command_takes_the_backend(cli, monkeypatch, tmp_path):
    monkeypatch.setattr(backend, "gpu_usable", lambda: False)
    monkeypatch.delenv(backend.BACKEND_VARIABLE, raising=False)
    for name in ("cuda", "opencl"):
        refused = cli("run", "hills", "--backend", name, "-o", tmp_path / "out", code=2)
        assert f"--backend: backend = {name}" in refused.stderr
        assert not (tmp_path / "out").exists()
        assert backend.BACKEND_VARIABLE not in os.environ


def test_sionna_loads_its_preview_when_a_scene_is_previewed():
    script = (
        "import sys\n"
        "from sionna_radar.raytracer.backend import load_mitsuba\n"
        "load_mitsuba()\n"
        "import sionna.rt\n"
        "scene = sionna.rt.load_scene(sionna.rt.scene.simple_reflector)\n"
        "assert 'pythreejs' not in sys.modules\n"
        "scene.preview()\n"
        "scene.preview()\n"
        "print('previewed by', type(scene._preview_widget).__module__)\n"
    )
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.splitlines()[-1] == "previewed by sionna.rt.preview"
