"""A survey flown once and mapped as often as wanted, each time with another navigation system.

Errors of navigation change nothing that is traced: the echoes are recorded once, and only their Doppler
correction, their location, the DEM and its comparison are done anew.

The tiles of a map are kept as they are finished, and made by workers if there are any.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

from sionna_radar.accuracy.compare import DemError
from sionna_radar.accuracy.truth import GroundTruth
from sionna_radar.flight.pulses import Navigation, build_navigation
from sionna_radar.foundation.checkpoints import Checkpoints
from sionna_radar.foundation.numerics import on_one_thread
from sionna_radar.foundation.progress import Progress, Step, silent
from sionna_radar.foundation.threads import several_at_once
from sionna_radar.foundation.workers import SHARED, Failure, Task, Workers, each_kept
from sionna_radar.mapping.mapper import Estimate
from sionna_radar.mapping.points import Points
from sionna_radar.mapping.terrain.tiles import EachPiece, MakePiece, Piece, Tiles, pieces_here
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.bases import NavigationParameters
from sionna_radar.survey.preparation import CustomParts, Prepared, prepare
from sionna_radar.survey.recording import BLOCK_SIZE, Recording, place
from sionna_radar.survey.sensors.sensor import Sensor
from sionna_radar.survey.shared_flight import ready, record_with

# Poses alone are small; mapping takes many at once.
MAPPED_AT_ONCE = 4096


@dataclass(frozen=True, kw_only=True)
class RecordedSurvey:
    """A prepared survey, the sensor that flew it, what it recorded, and the surface it flew over."""

    prepared: Prepared
    sensor: Sensor
    recording: Recording
    truth: GroundTruth

    def points(self, navigation: Navigation | None) -> Points:
        """Return the points as a navigation system places them; None knows the pose exactly."""
        schedule = self.prepared.with_navigation(navigation).flight
        return place(self.recording.echoes, self.sensor, schedule, block_size=MAPPED_AT_ONCE)

    def lit_error(self, navigation: Navigation | None) -> DemError:
        """Return the error of lit cells of the DEM made with a navigation system, by the scenario's own `dem.method`.

        Raises
        ------
        ScenarioError
            The method models whole echoes, and the sensor returns none.

        """
        prepared = self.prepared.with_navigation(navigation)
        made = prepared.mapper.map(self.points(navigation), self.recording.profiles, prepared.measured)
        return self.truth.lit_error(made.dem, self.recording.lit)

    def navigation(self, table: NavigationParameters, seed: int | None = None) -> Navigation | None:
        """Return a navigation system with some errors, on the lever arm of this survey."""
        scenario, schedule = self.prepared.local, self.prepared.flight
        table = table.model_copy(update={"lever_arm_m": schedule.lever_arm_m})
        seed = scenario.seed if seed is None else seed
        return build_navigation(table, schedule.trajectory, scenario.radar.chirp_rate_hz, seed)


def record_survey(
    scenario: Scenario,
    *,
    custom: CustomParts | None = None,
    block_size: int = BLOCK_SIZE,
    progress: Progress = silent,
    parts: Checkpoints | None = None,
    workers: Workers | None = None,
) -> RecordedSurvey:
    """Fly a survey and keep what is needed to map it again.

    Parameters
    ----------
    scenario:
        The survey; its own errors of navigation play no part.
    custom, block_size, progress, parts, workers:
        As for `prepare` and `sionna_radar.run`.

    Raises
    ------
    ScenarioError, InputFileError
        The scenario cannot be flown; see `prepare`.

    """
    prepared = prepare(scenario, custom, progress)
    sensor, recording = record_with(workers, prepared, block_size=block_size, progress=progress, parts=parts)
    return RecordedSurvey(prepared=prepared, sensor=sensor, recording=recording, truth=prepared.truth())


@lru_cache(maxsize=1)
def recorded_survey(scenario: str, recording: bytes) -> RecordedSurvey:
    """Return a survey that another process has flown, from the JSON text of its scenario and its packed recording."""
    prepared, sensor = ready(scenario)
    return RecordedSurvey(
        prepared=prepared, sensor=sensor, recording=Recording.unpacked(recording), truth=prepared.truth()
    )


# The bytes of a tile with too few echoes.
NOTHING = b""


def map_with(
    workers: Workers | None,
    prepared: Prepared,
    recording: Recording,
    points: Points,
    progress: Progress = silent,
    parts: Checkpoints | None = None,
) -> Estimate:
    """Return the DEM of a survey, bit for bit what its mapper makes alone.

    Parameters
    ----------
    workers:
        What makes the tiles of a map that has several; without it, or with parts replaced from Python, this process.
    prepared, recording, points:
        The survey, what its sensor observed, and the located echoes.
    progress:
        See `Mapper.map`.
    parts:
        Where finished tiles are kept, and those that are there already are taken from.

    """
    each: EachPiece = pieces_here if parts is None else _kept_in(parts)
    if workers is not None and workers.count and not prepared.custom.described():
        each = _made_by(workers, prepared, recording, parts, each)
    return prepared.mapper.map(points, recording.profiles, prepared.measured, progress, each)


def _kept_in(parts: Checkpoints) -> EachPiece:
    """Return an iterator function that makes the pieces in this process and stores them."""

    def each(make: MakePiece, count: int, steps: int, step: Step) -> Iterator[Piece | None]:
        def made(number: int, step: Step) -> Piece | None:
            content = parts.get(key_of_tile(number))
            if content is not None:
                return _piece_of(content)
            piece = make(number, step)
            parts.put(key_of_tile(number), _content_of(piece))
            return piece

        return several_at_once(made, range(count), [steps] * count, step)

    return each


def _made_by(
    workers: Workers, prepared: Prepared, recording: Recording, parts: Checkpoints | None, alone: EachPiece
) -> EachPiece:
    """Return an iterator function that makes the pieces on workers; a single one here, by `alone`, on all cores."""

    def each(make: MakePiece, count: int, steps: int, step: Step) -> Iterator[Piece | None]:
        if count < 2:
            yield from alone(make, count, steps, step)
            return
        scenario = prepared.scenario.model_dump_json()
        tasks = {key_of_tile(number): {"scenario": scenario, "tile": number} for number in range(count)}
        finished: dict[str, bytes] = {}
        wanted = iter(tasks)
        following = next(wanted)
        for key, found in each_kept(workers, tile_task, tasks, parts, shared=recording.packed()):
            if isinstance(found, Failure):
                raise found.error()
            finished[key] = found
            for _ in range(steps):
                step()
            while following in finished:
                yield _piece_of(finished.pop(following))
                following = next(wanted, "")

    return each


@on_one_thread
def tile_task(task: Task, progress: Progress) -> bytes:
    """Return the bytes of the piece of a task's tile."""
    return _content_of(_tiles_of(task["scenario"], task[SHARED]).piece(task["tile"]))


@lru_cache(maxsize=1)
def _tiles_of(scenario: str, recording: bytes) -> Tiles:
    """Return the tiles of a survey that another process has flown: a worker makes several."""
    survey = recorded_survey(scenario, recording)
    tiles = survey.prepared.mapper.tiles(survey.recording.profiles, survey.prepared.measured)
    assert tiles is not None  # tasks are made for the tiles of a map
    return tiles


def key_of_tile(number: int) -> str:
    """Return the name of a tile among the parts of its survey."""
    return f"tile {number} of the map"


def _content_of(piece: Piece | None) -> bytes:
    return NOTHING if piece is None else piece.packed()


def _piece_of(content: bytes) -> Piece | None:
    return None if content == NOTHING else Piece.unpacked(content)
