"""Work beside other work, on as many cores as there are."""

import threading

import pytest

from sionna_radar.foundation import threads
from sionna_radar.foundation.threads import beside, in_threads, several_at_once


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


@pytest.mark.parametrize("cores", [1, 2])
def test_several_at_once_come_in_order_and_all_their_steps_are_told(monkeypatch, cores):
    monkeypatch.setattr(threads, "cores", lambda: cores)
    told = []

    def work(number, step):
        for _ in range(number):  # of the four at the most
            step()
        return list(in_threads(lambda low, high: number * low, [(0, 1), (1, 2)]))

    results = []
    for result in several_at_once(work, [4, 0, 3], [4, 4, 4], lambda: told.append(len(results))):
        results.append(result)
    assert results == [[0, 4], [0, 0], [0, 3]]
    assert told == [0] * 4 + [1] * 4 + [2] * 4


def test_one_alone_tells_its_steps_as_it_does_them_and_has_all_cores(monkeypatch):
    monkeypatch.setattr(threads, "cores", lambda: 2)
    told, here = [], threading.current_thread()

    def work(number, step):
        step()
        assert told == [True]
        return threading.current_thread() is here

    assert list(several_at_once(work, [7], [2], lambda: told.append(threading.current_thread() is here))) == [True]
    assert told == [True, True]


def test_a_signal_ends_what_goes_on_at_once(monkeypatch):
    monkeypatch.setattr(threads, "cores", lambda: 2)
    monkeypatch.setattr(threads, "raise_received", lambda: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        list(several_at_once(lambda number, step: step(), [1, 2, 3], [1, 1, 1], lambda: None))
