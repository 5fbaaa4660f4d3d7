"""An observed survey that can be mapped again, with other navigation errors or in tiles on workers.

Navigation errors do not affect tracing: the survey is observed once, and only Doppler correction, location, DEM and
comparison are repeated.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

from sionna_radar.accuracy.compare import DemError
from sionna_radar.execution.execution import Execution
from sionna_radar.execution.workers import SHARED, Task
from sionna_radar.flight.build import build_navigation
from sionna_radar.flight.navigation import KnownPoses
from sionna_radar.flight.pulses import Navigation
from sionna_radar.foundation.columns import OF, columns_of, packed, table_of
from sionna_radar.foundation.linear_algebra import on_one_thread
from sionna_radar.foundation.progress import progress_to, silent
from sionna_radar.mapping.mapper import Estimate
from sionna_radar.mapping.points import Points
from sionna_radar.mapping.tiles import AnyPiece, MapTiles, TilePiece, pieces_here
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.bases import NavigationParameters
from sionna_radar.survey.custom_parts import CustomParts
from sionna_radar.survey.navigation import refined, with_refined
from sionna_radar.survey.observation import Observed, observe, on_this_worker
from sionna_radar.survey.placement import place
from sionna_radar.survey.preparation import Prepared, prepare
from sionna_radar.survey.sensors.sensor import Sensor


@dataclass(frozen=True, kw_only=True)
class ObservedSurvey:
    """A prepared survey, its sensor, and its observations."""

    prepared: Prepared
    sensor: Sensor
    observed: Observed

    def points(self, navigation: Navigation | None) -> Points:
        """Return the echoes located with a navigation system (None: exact poses)."""
        return place(self.observed.echoes, self.sensor, self.prepared.with_navigation(navigation).flight)

    def lit_error(self, navigation: Navigation | None, *, refines: bool = False) -> DemError:
        """Return the error of lit cells of the DEM made with a navigation system, by the scenario's own `dem.method`.

        refines: whether the echoes refine the navigation first.

        Raises
        ------
        ScenarioError
            The DEM method needs range profiles, which the sensor does not provide.
        """
        prepared = self.prepared.with_navigation(navigation)
        if refines:
            with progress_to(silent):
                prepared = with_refined(prepared, refined(prepared, self.observed))
        # Without its uncertainty a linear map takes a tenth of the time.
        mapper = replace(prepared.mapper, uncertain=prepared.mapper.min_confidence_m is not None)
        with progress_to(silent):
            points = place(self.observed.echoes, self.sensor, prepared.flight)
            made = mapper.map(points, self.observed.profiles, prepared.measured)
        assert self.observed.hits is not None  # the truth of a simulation is known
        return self.prepared.truth.lit_error(made.dem, self.observed.hits.lit)

    def navigation(self, table: NavigationParameters, seed: int | None = None) -> Navigation | None:
        """Return a navigation system with given errors and this survey's lever arm."""
        scenario, schedule = self.prepared.local, self.prepared.flight
        table = table.model_copy(update={"lever_arm_m": schedule.lever_arm_m})
        seed = scenario.seed if seed is None else seed
        return build_navigation(table, schedule.trajectory, scenario.radar.chirp_rate_hz, seed)


def observe_survey(
    scenario: Scenario, *, parts: CustomParts | None = None, execution: Execution | None = None
) -> ObservedSurvey:
    """Simulate a survey, and return what is needed to map it repeatedly.

    Parameters
    ----------
    scenario:
        The survey; its own navigation errors are ignored.
    parts, execution:
        As for `sionna_radar.run`.

    Returns
    -------
    The prepared survey, its sensor and its observations.

    Raises
    ------
    ScenarioError, InputFileError
        The scenario cannot be flown; see `prepare`.
    """
    execution = execution or Execution()
    with execution.reported():
        prepared = prepare(scenario, parts)
        sensor, observed = observe(prepared, execution)
    return ObservedSurvey(prepared=prepared, sensor=sensor, observed=observed)


@lru_cache(maxsize=1)
def restored_survey(scenario: str, observed: bytes) -> ObservedSurvey:
    """Return a survey observed by another process, from its scenario (JSON) and observations."""
    prepared, sensor = on_this_worker(scenario)
    return ObservedSurvey(prepared=prepared, sensor=sensor, observed=Observed.unpacked(observed))


# Serialised result of a tile with too few echoes.
NOTHING = b""


def map_observed(prepared: Prepared, observed: Observed, points: Points, execution: Execution) -> Estimate:
    """Return a survey's DEM, bit-identical to `Mapper.map`, with checkpoints and workers for its tiles."""

    def each(tiles: MapTiles[AnyPiece]) -> Iterator[AnyPiece | None]:
        """Yield the tiles, from workers unless parts are custom."""
        count = len(tiles)
        distributed = execution.distributed and count > 1 and not prepared.custom.described()
        if not distributed and execution.checkpoints is None:
            yield from pieces_here(tiles)
            return
        scenario = prepared.scenario.model_dump_json() if distributed else ""
        tasks = {f"tile {number} of the map": {"scenario": scenario, "tile": number} for number in range(count)}
        means = execution if distributed else Execution(checkpoints=execution.checkpoints)
        work = tile_task if distributed else lambda task: _content_of(tiles.piece(task["tile"]))
        estimated = prepared.flight.navigation if isinstance(prepared.flight.navigation, KnownPoses) else None
        shared = (
            packed(observed=observed, **({} if estimated is None else {"poses": estimated})) if distributed else None
        )
        done = means.done(tasks, work, shared=shared, steps=dict.fromkeys(tasks, tiles.steps), side_by_side=True)
        pieces = dict(done)
        for key in tasks:
            content = pieces.pop(key)
            yield None if content == NOTHING else tiles.unpacked(content)

    return prepared.mapper.map(points, observed.profiles, prepared.measured, each)


@on_one_thread
def tile_task(task: Task) -> bytes:
    """Return a serialised tile, computed on a worker."""
    return _content_of(_tiles_of(task["scenario"], task[SHARED]).piece(task["tile"]))


@lru_cache(maxsize=1)
def _tiles_of(scenario: str, observed: bytes) -> MapTiles[TilePiece]:
    """Return the tiles of a survey observed by another process, cached for the tasks of a worker."""
    survey = restored_survey(scenario, observed)
    columns, prepared = columns_of(observed), survey.prepared
    if f"poses{OF}time_s" in columns:
        prepared = prepared.with_navigation(table_of(KnownPoses, "poses", columns))
    points = place(survey.observed.echoes, survey.sensor, prepared.flight)
    tiles = prepared.mapper.tiles(points, survey.observed.profiles, prepared.measured)
    assert tiles is not None  # tasks are made for the tiles of a map
    return tiles


def _content_of(piece: TilePiece | None) -> bytes:
    return NOTHING if piece is None else piece.packed()
