"""Machine code where it cannot be kept, and what is said of compiling it."""

import contextlib
import gc
import os
import subprocess
import sys

import numpy as np
import pytest
from filelock import FileLock, Timeout
from numba import TypingError
from numba.core.caching import FunctionCache

from sionna_radar.foundation import machine_code as module
from sionna_radar.foundation.compiled import compiled
from sionna_radar.foundation.machine_code import on_first_compilation


def doubled(values):
    return 2.0 * values[0]


def is_locked(function):
    """Return whether a process is compiling the function."""
    try:
        with function.machine_code._cache._new_lock().acquire(blocking=False):
            return False
    except Timeout:
        return True


def test_without_a_folder_that_can_be_written_one_warning_says_so_and_the_code_runs(monkeypatch, caplog):
    monkeypatch.setattr(FunctionCache, "__init__", _without_a_folder)
    module._warn_once.cache_clear()
    functions = [compiled(doubled), compiled(doubled)]
    assert [function(np.array([1.5])) for function in functions] == [3.0, 3.0]
    assert len(caplog.records) == 1
    assert "NUMBA_CACHE_DIR" in caplog.text


def _without_a_folder(self, function):
    message = "cannot cache function: no locator available"
    raise RuntimeError(message)


def test_the_first_compilation_is_told_once(monkeypatch):
    monkeypatch.setattr(FunctionCache, "__init__", _without_a_folder)
    told = []
    on_first_compilation(lambda: told.append(True))
    function = compiled(doubled)
    assert told == []
    for values in (np.array([1.5]), np.array([1, 2])):
        function(values)
    assert told == [True]


KERNEL = """
from typing import NamedTuple
import numpy as np
from sionna_radar.foundation.compiled import compiled

class {name}(NamedTuple):
    values: np.ndarray

@compiled
def first(table):
    return table.values[0]

print(first({name}(np.array([{value}]))))
"""


def test_machine_code_of_a_type_that_was_renamed_is_compiled_anew(tmp_path):
    """The index on disk names its types, and is read before its time stamp is compared."""
    said = []
    for name, value in (("Older", 1.0), ("Newer", 2.0), ("Newer", 2.0)):
        (tmp_path / "kernel.py").write_text(KERNEL.format(name=name, value=value))
        done = subprocess.run(
            [sys.executable, "-B", "-c", "import kernel"],  # byte code knows a source by its second and its size
            cwd=tmp_path,
            env=os.environ | {"PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path / "cache")},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        said.append(done.stdout.strip())
    assert said == ["1.0", "2.0", "2.0"]
    assert list((tmp_path / "cache").rglob("*.nbc"))


SUMS = """
import sys
import numpy as np
from sionna_radar.foundation.compiled import compiled

@compiled
def sums(values):
    total = np.zeros(2)
    for value in values:
        total += value
    return total

@compiled
def other(values):
    return sums(values)[0] + 1.0

ones = np.ones(3)
print(sums(ones)[0], "numba.np.arraymath" in sys.modules)
if len(sys.argv) > 1:
    print(other(ones), "numba.np.arraymath" in sys.modules)
"""


def test_what_compiles_is_loaded_by_a_compilation_alone(tmp_path):
    """Cached code that allocates runs without it; what is compiled afterwards may call that code."""
    (tmp_path / "kernel.py").write_text(SUMS)
    said = []
    for arguments in ([], [], ["other"]):
        done = subprocess.run(
            [sys.executable, "kernel.py", *arguments],
            cwd=tmp_path,
            env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        said.append(done.stdout.split())
    assert said == [["3.0", "True"], ["3.0", "False"], ["3.0", "False", "4.0", "True"]]


def test_a_function_that_cannot_be_compiled_is_left_to_other_processes():
    @compiled
    def broken(values):
        return values.no_such_attribute

    lock = FileLock(broken.machine_code._cache._new_lock().lock_file)
    with pytest.raises(TypingError):
        broken(np.array([1.5]))
    with lock.acquire(blocking=False):
        pass
    assert gc.isenabled()


def test_a_function_is_not_given_to_other_processes_before_it_is_saved(monkeypatch):
    function, saved = compiled(doubled), []
    other = FileLock(function.machine_code._cache._new_lock().lock_file)
    monkeypatch.setattr(function.machine_code._cache, "_loaded", lambda *_: None)

    def save(self, signature, data) -> None:
        with pytest.raises(Timeout), other.acquire(blocking=False):
            pass
        saved.append(signature)

    monkeypatch.setattr(FunctionCache, "save_overload", save)
    assert function(np.array([1.5])) == 3.0
    assert len(saved) == 1
    with other.acquire(blocking=False):
        pass


def test_a_process_waits_for_another_that_compiles_the_same_function(monkeypatch):
    function = compiled(doubled)
    monkeypatch.setattr(function.machine_code._cache, "_loaded", lambda *_: None)
    other = FileLock(function.machine_code._cache._new_lock().lock_file)
    with other:
        monkeypatch.setattr(module, "MAX_WAIT_S", 0.2)
        assert function(np.array([1.5])) == 3.0
    assert not is_locked(function)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
def test_a_forked_process_compiles_a_function_of_its_parent(monkeypatch):
    """The command line forks once; whoever imported the package before it has made the caches of all its functions."""
    function = compiled(doubled)
    monkeypatch.setattr(function.machine_code._cache, "_loaded", lambda *_: None)
    child = os.fork()
    if child == 0:
        status = 1
        with contextlib.suppress(BaseException):
            status = 0 if function(np.array([1.5])) == 3.0 else 2
        os._exit(status)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    assert not is_locked(function)


SHIPPED = """
import sys
from pathlib import Path
import numpy as np
from sionna_radar.foundation import machine_code as module
module.SHIPPED = Path(sys.argv[1])
import kernel
print(kernel.scaled(np.array([1.5, 2.0])))
"""


def ran_with(folder, shipped, source, **environment):
    """Return what a kernel says in a process of its own, and whether it was compiled there."""
    folder.mkdir(exist_ok=True)
    text = "from sionna_radar.foundation.compiled import compiled\n\n@compiled\ndef scaled(values):\n    return {}\n"
    (folder / "kernel.py").write_text(text.format(source))
    cache = {"PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": str(folder / "cache")}
    command = [sys.executable, "-B", "-c", SHIPPED, str(shipped)]
    done = subprocess.run(
        command, env=os.environ | cache | environment, capture_output=True, text=True, check=False, cwd=folder
    )
    assert done.returncode == 0, done.stderr
    return float(done.stdout), bool(list((folder / "cache").rglob("*.nbc")))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="machine code travels in wheels for Linux alone")
def test_machine_code_that_a_wheel_brings_is_used_as_long_as_it_fits(tmp_path):
    shipped, text = tmp_path / "shipped", "3.0 * values[0] + values[1]"
    level = {"NUMBA_CPU_NAME": module.LEVEL, "NUMBA_CPU_FEATURES": ""}
    assert ran_with(tmp_path / "made", tmp_path / "none", text, **level) == (6.5, True)
    shipped.mkdir()
    for file in (tmp_path / "made" / "cache").rglob("*.nb[ic]"):
        (shipped / file.name).write_bytes(file.read_bytes())
    # A copy of the source elsewhere and of another date, with the same text.
    assert ran_with(tmp_path / "used", shipped, text) == (6.5, not module.host_runs_level())
    # Another text, another processor.
    assert ran_with(tmp_path / "edited", shipped, "3.0 * values[0] + 2.0 * values[1]") == (8.5, True)
    (shipped / "notes.txt").write_text("not code")
    for file in shipped.glob("*.nbc"):
        file.unlink()
    assert ran_with(tmp_path / "lost", shipped, text) == (6.5, True)


def test_an_older_processor_compiles(monkeypatch, tmp_path):
    monkeypatch.setattr(module, "SHIPPED", tmp_path)
    monkeypatch.setattr(module.llvmlite.binding, "get_host_cpu_features", lambda: {"avx2": False})
    module.host_runs_level.cache_clear()
    try:
        assert compiled(doubled).machine_code._cache._shipped is None
    finally:
        module.host_runs_level.cache_clear()
