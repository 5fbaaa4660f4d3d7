"""Work beside other work, on as many cores as there are."""

import threading

import pytest

from sionna_radar.foundation import progress, threads
from sionna_radar.foundation.progress import advance, progress_to, stage
from sionna_radar.foundation.threads import in_background, in_threads, several_at_once


@pytest.mark.parametrize("cores", [1, 2])
def test_what_runs_beside_gives_its_result_or_its_error(monkeypatch, cores):
    monkeypatch.setattr(threads, "cores", lambda: cores)
    first = in_background(lambda: 3)
    second = in_background(lambda: threading.current_thread() is threading.main_thread())
    assert (first(), second()) == (3, cores == 1)
    with pytest.raises(ZeroDivisionError):
        in_background(lambda: 1 // 0)()


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

    def work(number):
        advance(number)  # of the four at the most
        return list(in_threads(lambda low, high: number * low, [(0, 1), (1, 2)]))

    results = []
    with progress_to(lambda _, done, total: told.append((len(results), done))), stage("work", 12):
        for result in several_at_once(work, [4, 0, 3], [4, 4, 4]):
            results.append(result)
    assert results == [[0, 4], [0, 0], [0, 3]]
    done = {count: [steps for results, steps in told if results == count] for count in range(3)}
    assert {count: steps[-1] for count, steps in done.items()} == {0: 4, 1: 8, 2: 12}


def test_one_alone_tells_its_steps_as_it_does_them_and_has_all_cores(monkeypatch):
    monkeypatch.setattr(threads, "cores", lambda: 2)
    told, here = [], threading.current_thread()

    def work(number):
        advance()
        assert told[-1] == (1, True)
        return threading.current_thread() is here

    def listener(_, done, total):
        told.append((done, threading.current_thread() is here))

    with progress_to(listener), stage("work", 2):
        assert list(several_at_once(work, [7], [2])) == [True]
    assert told == [(0, True), (1, True), (2, True)]


def test_a_signal_ends_what_goes_on_at_once(monkeypatch):
    monkeypatch.setattr(threads, "cores", lambda: 2)
    monkeypatch.setattr(progress, "raise_received", lambda: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        list(several_at_once(lambda number: advance(), [1, 2, 3], [1, 1, 1]))
