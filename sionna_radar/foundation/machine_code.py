"""Machine code of compiled functions: Numba's dispatchers, and their cache on disk, which processes share."""

import gc
import hashlib
import logging
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import llvmlite.binding
from numba import njit
from numba.core import event
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.runtime import rtsys

if TYPE_CHECKING:
    from filelock import FileLock

# Longest wait for another process that compiles the same function; several seconds are usual.
MAX_WAIT_S = 60.0


# Machine code that a wheel brings, for processors of the level x86-64-v3 (AVX2, 2013); `.ci/wheel` makes it.
SHIPPED = Path(__file__).parents[1] / "machine_code"
LEVEL, FEATURES_OF_LEVEL = "x86-64-v3", ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe")


def dispatcher(function: Callable[..., object]) -> Any:
    """Return the compiled form of a function, specialised by the types of its arguments when it is called."""
    # No C callers: omitting the C entry point saves a tenth of the compilation.
    machine_code = njit(nogil=True, error_model="numpy", no_cfunc_wrapper=True)(function)
    try:
        machine_code._cache = SharedCache(function)  # as `enable_caching` does
    except RuntimeError:  # neither the package's folder nor the user's cache is writable
        _warn_once("compiled code cannot be cached, every run compiles anew: set NUMBA_CACHE_DIR to a writable folder")
    return machine_code


class SharedCache(FunctionCache):
    """Compiled code on disk, shared by processes: while one compiles a function, the others wait for it.

    Code belongs to the text of its source file, so that it outlives copies and changes of branch; Numba's own caches go
    by the file's date. Where a wheel brought the code of a function, that is used.
    """

    def __init__(self, function: Callable[..., object]) -> None:
        super().__init__(function)
        self._held: FileLock | None = None  # while this process compiles
        name, source = self._impl.filename_base, _digest(Path(function.__code__.co_filename))
        self._cache_file = IndexDataCacheFile(self._cache_path, name, source)
        self._shipped = (
            IndexDataCacheFile(str(SHIPPED), name, source) if SHIPPED.is_dir() and host_runs_level() else None
        )

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Return compiled code for argument types; None if this process has to compile it."""
        machine_code = self._loaded(signature, target)
        if machine_code is None and self._held is None:
            # Needed by compilations alone.
            from filelock import Timeout

            lock = self._new_lock()
            try:
                lock.acquire(timeout=MAX_WAIT_S)
            except Timeout:  # the other process is suspended, or very slow
                return None
            machine_code = self._loaded(signature, target)
            if machine_code is None:
                self._held = lock
            else:
                lock.release()
        return machine_code

    def save_overload(self, signature: Any, data: Any) -> None:
        """Save compiled code, and release the processes that wait for it."""
        try:
            super().save_overload(signature, data)
        finally:
            self.release()

    def release(self) -> None:
        """Release the lock of the function, so that other processes may compile it; no effect without the lock."""
        if self._held is not None:
            self._held.release()
            self._held = None

    def _new_lock(self) -> "FileLock":
        from filelock import FileLock

        # Not one for the life of the cache: a lock made before a fork cannot be taken in the child.
        return FileLock(f"{self._cache_file._index_path}.lock")

    def _loaded(self, signature: Any, target: Any) -> Any:
        # Memory management alone is set up, not what compilation needs, which takes a tenth of a second to import.
        rtsys.initialize(target)
        try:
            with self._guard_against_spurious_io_errors():
                found = self._load_overload(signature, target)
        except (AttributeError, ModuleNotFoundError):  # types were renamed or moved since the index was written
            self.flush()
            return None
        return found or self._brought(signature, target)

    def _brought(self, signature: Any, target: Any) -> Any:
        """Return the code that the wheel brought for argument types; None without any."""
        if self._shipped is None:
            return None
        signature, (triple, _, _), function = self._index_key(signature, target.codegen())
        data = self._shipped.load((signature, (triple, LEVEL, ""), function))
        return None if data is None else self._impl.rebuild(target, data)


@cache
def _digest(source: Path) -> str:
    return hashlib.sha256(source.read_bytes()).hexdigest()


@cache
def host_runs_level() -> bool:
    """Return True if this machine's processor is of the level of shipped code."""
    features = llvmlite.binding.get_host_cpu_features()
    return all(features.get(feature, False) for feature in FEATURES_OF_LEVEL)


class _Compilation(event.Listener):
    """Disable garbage collection during compilation, which takes a sixth less time without; clean up after failures."""

    def __init__(self) -> None:
        self._depth = 0
        self._enabled = True

    def on_start(self, event: object) -> None:
        if self._depth == 0:
            self._enabled = gc.isenabled()
            gc.disable()
        self._depth += 1

    def on_end(self, event: event.Event) -> None:
        """Collect garbage again; release those who wait for code that failed to compile."""
        # Not by `event.is_failed`, which Numba has the wrong way round. What was compiled is saved after this event.
        dispatcher, failed = event.data["dispatcher"], event.data["args"] not in event.data["dispatcher"].overloads
        if failed and isinstance(getattr(dispatcher, "_cache", None), SharedCache):
            dispatcher._cache.release()
        self._depth -= 1
        if self._depth == 0 and self._enabled:
            gc.enable()


event.register("numba:compile", _Compilation())


class _FirstCompilation(event.Listener):
    """Report the first compilation of this process."""

    def __init__(self, notify: Callable[[], object]) -> None:
        self._pending = [notify]

    def on_start(self, event: object) -> None:
        while self._pending:
            self._pending.pop()()

    def on_end(self, event: object) -> None:
        """Do nothing: the beginning is what counts."""


def on_first_compilation(notify: Callable[[], object]) -> None:
    """Call a function at the next compilation of this process, once."""
    event.register("numba:compile", _FirstCompilation(notify))


@cache
def _warn_once(message: str) -> None:
    logging.getLogger("sionna_radar").warning(message)
