"""Work beside other work, on as many cores as there are."""

import threading

import pytest

from sionna_radar.foundation import threads
from sionna_radar.foundation.threads import beside


@pytest.mark.parametrize("cores", [1, 2])
def test_what_runs_beside_gives_its_result_or_its_error(monkeypatch, cores):
    monkeypatch.setattr(threads, "cores", lambda: cores)
    first = beside(lambda: 3)
    second = beside(lambda: threading.current_thread() is threading.main_thread())
    assert (first(), second()) == (3, cores == 1)
    with pytest.raises(ZeroDivisionError):
        beside(lambda: 1 // 0)()
