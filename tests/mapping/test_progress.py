"""Long stages tell how far they are: counts rise to their totals, and what tells nothing is told for."""

from dataclasses import replace

import numpy as np
import pytest

from sionna_radar.execution.execution import Execution
from sionna_radar.foundation.interrupts import Interrupted
from sionna_radar.foundation.progress import advance, progress_to, stage
from sionna_radar.foundation.raster import Raster
from sionna_radar.mapping.build import build_dem_method
from sionna_radar.scenario import load_scenario
from sionna_radar.scenario.processing import DemTable
from sionna_radar.survey.chain import run
from sionna_radar.survey.custom_parts import CustomParts
from sionna_radar.survey.observation import observe
from sionna_radar.survey.placement import place
from sionna_radar.survey.preparation import prepare

QUICK = {
    "terrain": {"kind": "flat", "size_m": [300.0, 300.0]},
    "platform.length_m": 5.0,
    "platform.altitude_m": 25.0,
    "tracing.paths_per_pulse": 32,
    "dem.spacing_m": 3.0,
}


class Silent:
    """A DEM method that tells nothing."""

    profiles = "optional"

    def __call__(self, inputs) -> Raster:
        return Raster(grid=inputs.grid, height_m=np.zeros(inputs.grid.shape))


@pytest.fixture(scope="module")
def flown() -> tuple:
    """One flight, mapped by each method in turn."""
    prepared = prepare(load_scenario("hills", QUICK | {"dem.method": "refined"}))
    sensor, observed = observe(prepared, Execution())
    return prepared, observed, place(observed.echoes, sensor, prepared.flight)


def stages_of(calls: list[tuple[str, int, int]]) -> dict[str, list[tuple[int, int]]]:
    stages: dict[str, list[tuple[int, int]]] = {}
    for name, done, total in calls:
        stages.setdefault(name, []).append((done, total))
    return stages


def map_with(flown: tuple, method: str | Silent, listener) -> Raster:
    prepared, observed, points = flown
    built = build_dem_method(DemTable(method=method)) if isinstance(method, str) else method
    mapper = replace(prepared.mapper, method=built)
    with progress_to(listener), stage("mapping"):
        return mapper.map(points, observed.profiles, prepared.measured)


@pytest.mark.parametrize("method", ["linear", "smooth", "refined", "stepped", Silent()])
def test_counts_rise_to_their_totals(flown, method):
    calls: list[tuple[str, int, int]] = []
    map_with(flown, method, lambda *step: calls.append(step))
    stages = stages_of(calls)
    assert set(stages) == ({"levels", "labels", "mapping"} if method == "stepped" else {"mapping"})
    for counts in stages.values():
        done = [count for count, _ in counts]
        assert done == sorted(done)
        assert counts[-1][0] == counts[-1][1] > 0
    if method in ("refined", "stepped"):
        totals = {total for _, total in stages["mapping"]} - {0}
        assert len(totals) == 1
    if method == "refined":
        assert len(stages["mapping"]) == totals.pop() + 2  # each step once, after the start without and with a total


def test_an_interrupt_ends_a_map_at_its_next_step(flown):
    seen = []

    def stop(stage: str, done: int, total: int) -> None:
        seen.append(done)
        if done == 2:
            raise Interrupted

    with pytest.raises(Interrupted):
        map_with(flown, "refined", stop)
    assert seen[-1] == 2


def test_a_custom_method_that_ignores_progress_is_told_for():
    calls: list[tuple[str, int, int]] = []
    run(
        load_scenario("hills", QUICK),
        parts=CustomParts(dem_method=Silent()),
        execution=Execution(progress=lambda *step: calls.append(step)),
    )
    stages = stages_of(calls)
    assert list(stages) == ["preparing", "tracing", "mapping"]
    assert stages["mapping"] == [(0, 0), (1, 1)]
    assert all(counts[-1][0] == counts[-1][1] for counts in stages.values())


def test_preparing_tells_its_steps():
    calls: list[tuple[str, int, int]] = []
    with progress_to(lambda *step: calls.append(step)):
        prepare(load_scenario("hills", QUICK))
    assert calls == [("preparing", done, len(calls) - 1) for done in range(len(calls))]
    assert len(calls) > 4


def test_stages_count_their_own_steps_and_end_with_all_of_them():
    calls: list[tuple[str, int, int]] = []
    advance()  # outside of any stage
    with progress_to(lambda *step: calls.append(step)), stage("known", 3):
        advance()
        with stage("unknown"):
            advance(2)
        advance()
    assert calls == [
        ("known", 0, 3),
        ("known", 1, 3),
        ("unknown", 0, 0),
        ("unknown", 2, 0),
        ("unknown", 2, 2),
        ("known", 2, 3),
        ("known", 3, 3),
    ]
