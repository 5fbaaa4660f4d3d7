"""The list of what a first run compiles ahead, held against what surveys call."""

import subprocess
import sys

import pytest
from numba import types
from numba.core.caching import FunctionCache

from sionna_radar.foundation import precompile
from sionna_radar.foundation.compiled import compiled
from sionna_radar.foundation.precompile import main, signatures

CALLED = """
import sys
from sionna_radar import load_scenario, run
from sionna_radar.foundation.precompile import PACKAGE, described, signatures
from sionna_radar.scenario.overrides import parse_overrides
from numba.core.dispatcher import Dispatcher

run(load_scenario("hills", parse_overrides(sys.argv[2:])))
listed = {(function.py_func.__qualname__, types) for function, types in signatures(sys.argv[1])}
for name, module in list(sys.modules.items()):
    for function in vars(module).values() if name.startswith(PACKAGE) else ():
        if isinstance(function, Dispatcher) and function.__module__ == name:
            for types in function.signatures:
                if (function.py_func.__qualname__, types) not in listed:
                    print(name, function.py_func.__qualname__, [described(each) for each in types])
"""


@pytest.mark.parametrize("method", ["linear", "smooth", "refined"])
def test_all_that_a_survey_calls_is_compiled_ahead(method):
    done = subprocess.run(
        [sys.executable, "-c", CALLED, method, f"dem.method={method}", "platform.length_m=20.0"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "", "tests/foundation/record_signatures.py writes the list anew"


@pytest.mark.parametrize("method", ["linear", "smooth", "refined", "stepped"])
def test_every_line_names_a_compiled_function(method):
    functions = list(signatures(method))
    assert len(functions) > 30
    for function, _ in functions:
        assert function.targetoptions["nogil"]
    assert len(functions) == len({(function, types) for function, types in functions})


@pytest.mark.parametrize("place", ["chosen", "package", "user"])
def test_processes_are_started_unless_the_last_function_is_on_disk(place, monkeypatch, tmp_path):
    started = []
    monkeypatch.setattr(precompile.subprocess, "Popen", lambda command, **_: started.append(command))
    monkeypatch.setattr(precompile, "cores", lambda: 3)
    monkeypatch.setattr(precompile, "_lines", lambda method: iter([("scene.relief", "_hides", ""), ("a.b", "c", "")]))
    monkeypatch.setattr(precompile, "HERE", tmp_path / "package")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "user"))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    if place == "chosen":
        monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "chosen"))
    folders = {"chosen": "chosen/a_1234", "package": "package/a/__pycache__", "user": "user/numba/a_1234"}
    folder = tmp_path / folders[place]
    folder.mkdir(parents=True)
    (folder / "b.cd-7.py311.nbi").touch()
    precompile.start("linear")
    assert [command[-1] for command in started] == ["linear", "linear"]
    (folder / "b.c-7.py311.nbi").touch()
    precompile.start("linear")
    assert len(started) == 2


def test_processes_are_started_without_numba():
    code = "import sys; from sionna_radar.foundation import precompile; print('numba' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"


def test_nothing_is_compiled_ahead_where_it_cannot_be_kept(monkeypatch):
    monkeypatch.setattr(FunctionCache, "__init__", _not_writable)
    function = compiled(lambda value: value)
    monkeypatch.setattr(precompile, "signatures", lambda method: iter([(function, (types.int64,))]))
    main(["linear"])
    assert function.signatures == []


def _not_writable(self, function):
    message = "cannot cache function: no locator available"
    raise RuntimeError(message)


def test_the_list_is_compiled_unless_the_process_that_asked_has_ended(monkeypatch):
    parents = iter([7, 7, 7, 1])
    monkeypatch.setattr("sionna_radar.foundation.precompile.os.getppid", lambda: next(parents))
    main(["linear"])
    (first, types), (second, others) = list(signatures("linear"))[:2]
    assert types in first.signatures
    assert others in second.signatures
