"""Maps in tiles: kept as they are finished, made by workers, and the same bits whoever makes them."""

import pytest

from cluster_tasks import LikeWorkers
from sionna_radar.execution.checkpoints import open_checkpoints
from sionna_radar.execution.execution import Execution
from sionna_radar.execution.workers import Failure
from sionna_radar.foundation.errors import OutputError
from sionna_radar.mapping.refined.refinement import Smooth
from sionna_radar.mapping.tiles import Tiles
from sionna_radar.scenario import load_scenario
from sionna_radar.survey import navigation, observed_survey
from sionna_radar.survey.chain import run
from sionna_radar.survey.custom_parts import CustomParts

pytestmark = pytest.mark.usefixtures("rough_errors")

# Two tiles.
WIDE = {
    "platform.length_m": 150.0,
    "platform.speed_mps": 60.0,
    "radar.chirp_rate_hz": 180.0,
    "terrain.spacing_m": 2.0,
    "tracing.paths_per_pulse": 48,
    "dem.spacing_m": 2.0,
    "radar.antenna.beamwidth_deg": 4.0,
}
WINDOW_M = 20.0


class Next(LikeWorkers):
    """Knows which tiles it has made."""

    @property
    def made(self):
        return [task["tile"] for task in self.tasks if "tile" in task]


def known(survey):
    """Return all that a map tells, as bytes."""
    corner = survey.dem.grid.centres_m[:100]
    mean = survey.uncertainty.mean_sigma_m(corner, WINDOW_M)
    return survey.dem.height_m.tobytes(), survey.dem_sigma.height_m.tobytes(), mean


@pytest.fixture(scope="module", params=["smooth", "refined"])
def scenario(request):
    return load_scenario("hills", WIDE | {"dem.method": request.param})


@pytest.fixture(scope="module")
def alone(scenario):
    return run(scenario)


def test_a_map_is_the_same_on_workers(scenario, alone):
    workers = Next()
    there = run(scenario, execution=Execution(workers=workers))
    assert workers.made == [1, 0]
    assert known(there) == known(alone)


def test_finished_tiles_are_not_made_again(scenario, alone, tmp_path, monkeypatch):
    made = []
    piece = Tiles.piece

    def counted(self, number):
        made.append(number)
        if len(made) == 2:
            raise KeyboardInterrupt
        return piece(self, number)

    monkeypatch.setattr(Tiles, "piece", counted)
    monkeypatch.setenv("SIONNA_RADAR_THREADS", "1")
    told = []
    with pytest.raises(KeyboardInterrupt), open_checkpoints(tmp_path, {}, resume=False) as parts:
        run(scenario, execution=Execution(checkpoints=parts))
    with open_checkpoints(tmp_path, {}, resume=True) as parts:
        again = run(scenario, execution=Execution(checkpoints=parts, progress=lambda *done: told.append(done)))
    assert made == [0, 1, 1]
    assert known(again) == known(alone)
    mapping = [(done, total) for stage, done, total in told if stage == "mapping" and total]
    assert mapping[-1][0] == mapping[-1][1]


def test_workers_take_tiles_that_are_kept(scenario, alone, tmp_path):
    first, second = Next(), Next()
    with open_checkpoints(tmp_path, {}, resume=False) as parts:
        run(scenario, execution=Execution(checkpoints=parts, workers=first))
        again = run(scenario, execution=Execution(checkpoints=parts, workers=second))
    assert first.made == [1, 0]
    assert second.tasks == []
    assert known(again) == known(alone)


def test_a_tile_that_fails_ends_the_survey_with_its_reason(scenario):
    class Failing(Next):
        def each(self, work, tasks, shared=None):
            if work is not observed_survey.tile_task:
                yield from super().each(work, tasks, shared)
                return
            yield 0, Failure(kind="OutputError", text="no room")

    with pytest.raises(OutputError, match="no room"):
        run(scenario, execution=Execution(workers=Failing()))


def test_tiles_of_refined_navigation_have_its_poses(monkeypatch):
    """Poses are refined before any tile is made, here once for both maps."""
    refine, refined = navigation.refined_navigation, []

    def refined_once(*given):
        if not refined:
            refined.append(refine(*given))
        return refined[0]

    monkeypatch.setattr(navigation, "refined_navigation", refined_once)
    keys = {
        "dem.method": "smooth",
        "radar.chirp_rate_hz": 360.0,
        "platform.navigation.attitude_markov_deg": 0.3,
        "processing.navigation": "refined",
    }
    workers, scenario = Next(), load_scenario("hills", WIDE | keys)
    shared = run(scenario, execution=Execution(workers=workers))
    assert workers.made
    assert shared.navigation is not None
    assert known(shared) == known(run(scenario))


def test_a_single_tile_is_made_here():
    workers, single = Next(), {"dem.method": "smooth", "dem.method_parameters.tile_m": 1000.0}
    run(load_scenario("hills", WIDE | single), execution=Execution(workers=workers))
    assert workers.tasks
    assert workers.made == []


def test_parts_from_python_are_not_sent(monkeypatch, tmp_path):
    """A survey that is recorded is flown here, with what was given from Python; so it is mapped here."""
    workers = Next()
    run(
        load_scenario("hills", WIDE),
        recordings={"profiles": tmp_path / "profiles.nc"},
        parts=CustomParts(dem_method=Smooth()),
        execution=Execution(workers=workers),
    )
    assert workers.tasks == []
