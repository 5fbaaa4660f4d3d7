"""Mitsuba and Dr.Jit: the libLLVM that their CPU variant needs, the choice of variant, and flushing of denormals.

Dr.Jit compiles kernels with a shared libLLVM. Versions before 17 cannot compile Mitsuba's and end the process
with a signal instead of an exception, so the library is selected, and an old one refused, before Dr.Jit loads.

Denormal numbers, too small for their exponent, are taken for zero, as in Dr.Jit's own threads. Embree asks for it.
Dr.Jit sets it in the threads that it starts; where it may use one thread only, it works in the thread that calls it,
where it is not set. Rays along the edge of two triangles would then give other hits.
"""

import ctypes
import ctypes.util
import functools
import os
import platform
import re
import site
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial, wraps
from importlib import import_module, metadata
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

import numpy as np
from jaxtyping import Shaped
from numpy.typing import DTypeLike

from sionna_radar.foundation.deferred import PLOTTING, deferred
from sionna_radar.foundation.errors import BackendError
from sionna_radar.foundation.threads import thread_limit

# Words of the floating-point environment (fenv.h), which of them controls this, and its bits: on x86-64 MXCSR's "flush
# to zero" and "denormals are zero", on 64-bit Arm FPCR's "flush to zero".
ENVIRONMENTS = {"x86_64": (8, 7, 0x8040), "aarch64": (2, 0, 1 << 24)}


@contextmanager
def flushed_denormals() -> Iterator[None]:
    """Flush denormals to zero in this thread; does nothing unless `can_flush`."""
    library = _library()
    if library is None:
        yield
        return
    words, word, bits = ENVIRONMENTS[platform.machine()]
    before, within = (ctypes.c_uint32 * words)(), (ctypes.c_uint32 * words)()
    library.fegetenv(before)
    library.fegetenv(within)
    within[word] |= bits
    library.fesetenv(within)
    try:
        yield
    finally:
        library.fesetenv(before)


def can_flush() -> bool:
    """Return True if Python threads can flush denormals to zero on this machine."""
    return _library() is not None


@cache
def _library() -> Any:
    if not sys.platform.startswith("linux") or platform.machine() not in ENVIRONMENTS:
        return None
    try:
        library = ctypes.CDLL("libm.so.6")
    except OSError:  # another C library
        return None
    return library if hasattr(library, "fesetenv") else None


# Widest vectors of Dr.Jit, bytes.
VECTOR_BYTES = 64


def aligned(values: Shaped[np.ndarray, " n"], dtype: DTypeLike = np.float32) -> Shaped[np.ndarray, " n"]:
    """Return values as Dr.Jit should get them, copied unless they lie so already.

    Dr.Jit takes arrays over where they lie, and compiles a kernel for each combination of inputs that begin at a
    multiple of the width of its vectors and others that do not, which NumPy leaves to chance. Of an array of several
    columns it compiles one for each length: the columns are given one by one.
    """
    if values.dtype == dtype and values.flags.c_contiguous and values.ctypes.data % VECTOR_BYTES == 0:
        return values
    result = aligned_room(len(values), dtype)
    result[:] = values
    return result


def aligned_room(count: int, dtype: DTypeLike = np.float32) -> Shaped[np.ndarray, " n"]:
    """Return an array to be written into, as Dr.Jit should get it; see `aligned`."""
    size = count * np.dtype(dtype).itemsize
    room = np.empty(size + VECTOR_BYTES, dtype=np.uint8)
    begin = -room.ctypes.data % VECTOR_BYTES
    return room[begin : begin + size].view(dtype)


OLDEST_LLVM = 17
VARIANTS = {"llvm": "llvm_ad_mono_polarized", "cuda": "cuda_ad_mono_polarized"}
WHEEL = "karellen-llvm-core"
LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"
# auto, llvm or cuda; the workers of a cluster inherit it.
BACKEND_VARIABLE = "SIONNA_RADAR_BACKEND"
AUTO = "auto"
# Viewers of Sionna RT, by module.
VIEWERS = {"sionna.rt.preview": "Previewer", "sionna.rt.rcs.scattering_model_viewer": "ScatteringModelViewer"}

REMEDIES = {
    "Linux": "install the wheel karellen-llvm-core, or your distribution's libllvm17 or newer",
    "Darwin": "install LLVM with `brew install llvm`",
    "Windows": "install LLVM 17 or newer from its official installer",
}


@dataclass(frozen=True)
class LlvmLibrary:
    """A libLLVM and where it was found."""

    path: str
    version: str
    origin: str


@functools.cache
def find_llvm() -> LlvmLibrary:
    """Return the first usable libLLVM: the user's, the wheel's, then the system's.

    Raises BackendError if none is found, or the user's is too old.
    """
    own = os.environ.get(LLVM_VARIABLE)
    if own:
        version = _llvm_version(own)
        if version is None:
            raise BackendError(
                f"{LLVM_VARIABLE} = {own} is not a libLLVM of version {OLDEST_LLVM} or newer; "
                f"unset it or {REMEDIES.get(platform.system(), 'install LLVM')}"
            )
        return LlvmLibrary(own, version, f"environment variable {LLVM_VARIABLE}")
    wheels = _wheel_libraries()
    for path in wheels:
        version = _llvm_version(str(path))
        if version is not None:
            return LlvmLibrary(str(path), version, f"wheel {WHEEL}")
    for name in _system_libraries():
        version = _llvm_version(name)
        if version is not None:
            return LlvmLibrary(name, version, "system")
    remedy = REMEDIES.get(platform.system(), "install LLVM")
    message = f"no libLLVM of version {OLDEST_LLVM} or newer was found; {remedy}, or point {LLVM_VARIABLE} at one"
    raise BackendError(message + "".join(map(_obstacle, wheels[:1])))


def _obstacle(path: Path) -> str:
    """Return the loader's message about a library, such as a dependency that a minimal system lacks (libatomic1)."""
    try:
        ctypes.CDLL(str(path))
    except OSError as error:
        return f". The wheel is installed but does not load: {error}"
    return ""


def use_backend(name: str) -> None:
    """Choose the backend of this process and of those that it starts: "llvm" for the CPU, "cuda" for a GPU, or "auto".

    Raises BackendError for another name, for "cuda" where no GPU is usable, and after another one was loaded.
    """
    before = os.environ.get(BACKEND_VARIABLE)
    os.environ[BACKEND_VARIABLE] = name
    try:
        chosen = chosen_backend()
        loaded = sys.modules["mitsuba"].variant() if "mitsuba" in sys.modules else None
        if loaded is not None and loaded != VARIANTS[chosen]:
            message = f"backend = {name} comes too late: {loaded} is loaded already; choose it in a new process"
            raise BackendError(message)
    except BackendError:
        os.environ.pop(BACKEND_VARIABLE)
        if before is not None:
            os.environ[BACKEND_VARIABLE] = before
        raise


def chosen_backend() -> Literal["llvm", "cuda"]:
    """Return the tracing backend: the one in SIONNA_RADAR_BACKEND, by default a GPU if one is usable.

    Raises BackendError for an unknown name, or "cuda" where no GPU is usable.
    """
    wanted = os.environ.get(BACKEND_VARIABLE, AUTO)
    if wanted not in (AUTO, *VARIANTS):
        message = f"backend = {wanted} ({BACKEND_VARIABLE}) is unknown; use one of {', '.join((AUTO, *VARIANTS))}"
        raise BackendError(message)
    if wanted == "llvm":
        return "llvm"
    usable = gpu_usable()
    if wanted == "cuda" and not usable:
        message = "backend = cuda has no usable GPU with a CUDA driver here; use llvm, or auto to take what there is"
        raise BackendError(message)
    return "cuda" if usable else "llvm"


@functools.cache
def load_mitsuba() -> Any:
    """Import Mitsuba with a variant that Sionna RT runs on, and return the module.

    Raises
    ------
    BackendError
        The backend that is asked for cannot run here, no libLLVM is usable, or Dr.Jit was imported before one was
        selected.
    """
    backend = chosen_backend()
    if backend == "llvm":
        library = find_llvm()
        if "drjit" in sys.modules and os.environ.get(LLVM_VARIABLE) is None and library.origin != "system":
            raise BackendError(
                f"Dr.Jit was imported before its libLLVM was selected; set {LLVM_VARIABLE}={library.path}, "
                "or import drjit, mitsuba and sionna only after sionna_radar has built a scene"
            )
        os.environ[LLVM_VARIABLE] = library.path
    with _loops_rewritten_when_run():
        import mitsuba

        if mitsuba.variant() not in VARIANTS.values():
            mitsuba.set_variant(VARIANTS[backend])
    if backend == "llvm":
        _use_threads()
    _defer_viewers()
    return mitsuba


@contextmanager
def _loops_rewritten_when_run() -> Iterator[None]:
    """Let Dr.Jit rewrite loops of the modules that are imported here when they first run: most of them never do."""
    import drjit

    rewritten = drjit.syntax

    def late(function: Callable[..., Any] | None = None, **options: Any) -> Callable[..., Any]:
        if function is None:
            return partial(late, **options)
        meant = cache(lambda: rewritten(function, **options))
        return wraps(function)(lambda *given, **named: meant()(*given, **named))

    drjit.syntax = late
    try:
        yield
    finally:
        drjit.syntax = rewritten


@cache
def _defer_viewers() -> None:
    """Let Sionna RT load what shows scenes and targets in notebooks, 400 modules, when something is shown."""
    for module, viewer in VIEWERS.items():
        empty = ModuleType(module)
        setattr(empty, viewer, partial(_viewer, empty, viewer))
        sys.modules.setdefault(module, empty)


def _viewer(empty: ModuleType, name: str, *given: Any, **named: Any) -> Any:
    """Return a viewer of the module that an empty one stands for."""
    if sys.modules[empty.__name__] is empty:
        del sys.modules[empty.__name__]
    return getattr(import_module(empty.__name__), name)(*given, **named)


@functools.cache
def load_sionna() -> Any:
    """Import Sionna RT after `load_mitsuba`, without what only its pictures need, and return the module.

    Raises BackendError as `load_mitsuba` does.
    """
    load_mitsuba()
    with deferred(PLOTTING), _loops_rewritten_when_run():
        import sionna.rt
    return sionna.rt


def release_arrays() -> None:
    """Release memory that Dr.Jit caches for later arrays; does nothing if it is not loaded."""
    drjit = sys.modules.get("drjit")
    if drjit is not None:
        drjit.flush_malloc_cache()


def _use_threads() -> None:
    """Set Dr.Jit's number of threads to that of this process.

    With one thread Dr.Jit works in the calling thread, which must flush denormals to zero; if it cannot, two are
    used.
    """
    import drjit

    wanted = max(thread_limit() or drjit.thread_count(), 1 if can_flush() else 2)
    if drjit.thread_count() != wanted:
        drjit.set_thread_count(wanted)


def _wheel_libraries() -> list[Path]:
    """Return the libraries of the wheel, newest first, from any install location: prefix, user or path."""
    try:
        files = metadata.files(WHEEL) or []
    except metadata.PackageNotFoundError:
        files = []
    recorded = [Path(str(file.locate())) for file in files if file.name.startswith("libLLVM.so")]
    roots = {Path(sys.prefix), Path(site.getuserbase()), *(Path(entry) for entry in sys.path)}
    beside = [path for root in roots for path in (root / "lib").glob("libLLVM.so.*")]
    found = {path.resolve() for path in [*recorded, *beside] if path.is_file()}
    return sorted(found, key=_number_in_name, reverse=True)


def _system_libraries() -> list[str]:
    names = [name for name in [ctypes.util.find_library("LLVM")] if name]
    if platform.system() == "Darwin":
        roots = (Path("/opt/homebrew/opt/llvm/lib"), Path("/usr/local/opt/llvm/lib"))
        return names + [str(root / "libLLVM.dylib") for root in roots]
    if platform.system() == "Windows":
        return [*names, str(Path(os.environ.get("PROGRAMFILES", "C:\\")) / "LLVM" / "bin" / "LLVM-C.dll")]
    found = [p for root in (Path("/usr/lib"), Path("/usr/lib64")) for p in root.glob("**/libLLVM*.so*")]
    return names + [str(p) for p in sorted(found, key=_number_in_name, reverse=True)]


def _number_in_name(path: Path) -> int:
    numbers = re.findall(r"\d+", path.name)
    return int(numbers[0]) if numbers else 0


def _llvm_version(path: str) -> str | None:
    """Return the version of a libLLVM, or None when it does not load or is too old.

    Versions before 16 lack LLVMGetVersion, so its absence marks an unusable library.
    """
    try:
        get_version = ctypes.CDLL(path).LLVMGetVersion
    except (OSError, AttributeError):
        return None
    parts = [ctypes.c_uint() for _ in range(3)]
    get_version(*map(ctypes.byref, parts))
    numbers = [part.value for part in parts]
    return ".".join(map(str, numbers)) if numbers[0] >= OLDEST_LLVM else None


@functools.cache
def gpu_usable() -> bool:
    """Return True if a CUDA driver with at least one device is present, without loading Dr.Jit."""
    library = "nvcuda.dll" if platform.system() == "Windows" else "libcuda.so.1"
    try:
        cuda = ctypes.CDLL(library)
        count = ctypes.c_int(0)
        return cuda.cuInit(0) == 0 and cuda.cuDeviceGetCount(ctypes.byref(count)) == 0 and count.value > 0
    except (OSError, AttributeError):
        return False


@dataclass(frozen=True)
class BackendReport:
    """The backend of the ray tracer on this machine."""

    variant: str
    threads: int
    llvm: LlvmLibrary | None
    gpu: str


def describe_backend() -> BackendReport:
    """Load the backend, trace one ray on it, and describe it.

    Raises BackendError if it does not load or traces incorrectly.
    """
    mi = load_mitsuba()
    import drjit as dr

    sphere = mi.load_dict({"type": "scene", "sphere": {"type": "sphere"}})
    hit = sphere.ray_intersect(mi.Ray3f(mi.Point3f(0, 0, 3), mi.Vector3f(0, 0, -1)))
    if abs(float(hit.t[0]) - 2.0) > 1e-5:
        raise BackendError(f"the ray tracer hit a unit sphere at {float(hit.t[0])} instead of 2; reinstall mitsuba")
    on_cpu = mi.variant().startswith("llvm")
    return BackendReport(
        variant=mi.variant(),
        threads=dr.thread_count(),
        llvm=find_llvm() if on_cpu else None,
        gpu="usable" if gpu_usable() else "none usable",
    )
