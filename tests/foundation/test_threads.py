"""Work beside other work, on as many cores as there are."""

import threading

import pytest

from sionna_radar.foundation import threads
from sionna_radar.foundation.threads import beside, in_threads


@pytest.mark.parametrize("cores", [1, 2])
def test_what_runs_beside_gives_its_result_or_its_error(monkeypatch, cores):
    monkeypatch.setattr(threads, "cores", lambda: cores)
    first = beside(lambda: 3)
    second = beside(lambda: threading.current_thread() is threading.main_thread())
    assert (first(), second()) == (3, cores == 1)
    with pytest.raises(ZeroDivisionError):
        beside(lambda: 1 // 0)()


def test_loops_within_loops_do_not_wait_for_each_other(monkeypatch):
    monkeypatch.setattr(threads, "cores", lambda: 2)
    bounds = [(k, k + 1) for k in range(8)]

    def outer(low, _):
        return sum(in_threads(lambda first, last: low * first * last, bounds))

    assert list(in_threads(outer, bounds)) == [k * sum(j * (j + 1) for j in range(8)) for k in range(8)]
