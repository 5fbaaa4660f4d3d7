"""The list of what a first run compiles ahead, held against what surveys call."""

import subprocess
import sys

import pytest
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


def test_without_a_cache_on_disk_nothing_is_compiled_ahead(monkeypatch):
    monkeypatch.setattr(FunctionCache, "__init__", _not_writable)
    function = compiled(lambda value: value)
    monkeypatch.setattr(precompile, "signatures", lambda method: iter([(function, ())]))
    started = []
    monkeypatch.setattr(precompile.subprocess, "Popen", started.append)
    precompile.start("linear")
    assert started == []


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
