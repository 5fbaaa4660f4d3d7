"""Machine code where it cannot be kept, and what is said of compiling it."""

import numpy as np
from numba.core.caching import FunctionCache

from sionna_radar.foundation import compiled as module
from sionna_radar.foundation.compiled import compiled, on_first_compilation


def doubled(values):
    return 2.0 * values[0]


def test_without_a_folder_that_can_be_written_one_warning_says_so_and_the_code_runs(monkeypatch, caplog):
    monkeypatch.setattr(FunctionCache, "__init__", _without_a_folder)
    module._say_once.cache_clear()
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
