"""Time left of a stage, on the recorded steps of a flight over San Francisco: run, stage, time (s), steps, of how many.

`cold` compiled all functions, `warm` none; `levels` and `mapping` come in bursts.
"""

from pathlib import Path

import pytest

from sionna_radar.foundation.progress_bars import RemainingTime

RECORDED = [line.split() for line in Path(__file__).with_name("city_progress.txt").read_text().splitlines()]


@pytest.mark.parametrize("run", ["cold", "warm"])
def test_what_is_shown_is_known_within_a_factor_of_two(run):
    left, end_s = RemainingTime(), {(row[0], row[1]): float(row[2]) for row in RECORDED}
    shown = []
    for _, stage, time_s, done, total in (row for row in RECORDED if row[0] == run):
        found_s = left.seconds(stage, int(done), int(total), float(time_s))
        if found_s is not None and done != total:
            true_s = end_s[run, stage] - float(time_s)
            assert true_s / 2 - 1 <= found_s <= 2 * true_s + 1
            shown.append(stage)
    assert shown.count("tracing") > 20


def test_nothing_is_shown_of_the_first_steps_and_of_a_stage_without_an_end():
    left = RemainingTime()
    assert [left.seconds("mapping", done, 560, 26.2 * done) for done in range(20)] == [None] * 20
    assert [left.seconds("listening", done, 0, float(done)) for done in range(100)] == [None] * 100


def test_a_slow_first_step_does_not_count():
    left = RemainingTime()
    for done in range(300):
        found_s = left.seconds("mapping", done, 560, 26.0 + 0.1 * done if done else 0.0)
    assert found_s == pytest.approx(26.1)
