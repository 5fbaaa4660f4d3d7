"""A recording beside its simulation: the recorded poses are flown over a reference with the radar of a scenario.

Both are processed alike, and compared by `twin.statistics`.
"""

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from pyproj import CRS
from scipy.spatial import KDTree

from sionna_radar.detection.detector import RESPONSE_CELLS
from sionna_radar.detection.echoes import Echoes, Profiles
from sionna_radar.elevation.local_frame import frame_of
from sionna_radar.elevation.placed_raster import reproject
from sionna_radar.execution.execution import BLOCK_SIZE
from sionna_radar.flight.pulses import MeasuredPoseFlight, Pose, Pulses
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.linear_algebra import on_one_thread
from sionna_radar.foundation.progress import advance, stage
from sionna_radar.foundation.raster import Georeference, Raster
from sionna_radar.mapping.points import Points
from sionna_radar.radar.build import build_sweeps
from sionna_radar.scenario import Scenario, load_scenario
from sionna_radar.scene.terrains.build import map_frame
from sionna_radar.studies.twin.statistics import (
    Look,
    Pair,
    Row,
    Side,
    Statistic,
    dem_rows,
    power_rows,
    range_rows,
    rows_of,
    shape_rows,
)
from sionna_radar.survey.custom_parts import CustomParts, over_file
from sionna_radar.survey.placement import place
from sionna_radar.survey.preparation import Prepared, prepare
from sionna_radar.survey.recording_source import (
    RangeReadings,
    RecordedSensor,
    RecordingSource,
    check_same_radar,
    open_recording,
)
from sionna_radar.survey.recordings.described import DescribedRanges
from sionna_radar.survey.reprocessing import SPECTRUM_PULSES
from sionna_radar.survey.sensors.radar import Radar
from sionna_radar.survey.sensors.sensor import Sensor
from sionna_radar.survey.sensors.sweeps import Beats

logger = logging.getLogger("sionna_radar")

# Halvings of the ground into tiles: at most, and at least for a test; the pulses that a tile holds at least.
MAX_HALVINGS, MIN_HALVINGS, MIN_TILE_PULSES = 6, 4, 4
# Footprints across a tile, at least: neighbouring beams share ground, and with it their speckle and errors.
TILE_FOOTPRINTS = 2.0
# Half-width of the echo's cells: range cells, and spreads of the beam over the ground; of those beside it, in these.
ECHO_CELLS, ECHO_SPREADS, BESIDE_WIDTHS = 4.0, 1.5, 3.0
# Steepest incidence from which the spread of an echo is taken.
STEEPEST_DEG = 75.0
# Share of the ranges, the quietest, that hold the floor.
QUIETEST = 0.2
PROCESSED_KEYS = ("processing", "dem")


@dataclass(frozen=True, kw_only=True)
class Twin:
    """A recording beside its simulation; of readings that of their ranges alone.

    source: the recording. scenario: what was simulated. rows: the comparison.
    blocks: number of tiles of the ground whose labels the test exchanges, and pulses in each.
    profiles: mean power about the expected range, measured and simulated, at sampled offsets `profile_m`.
    levels_known: whether the unit of the recorded power is that of the simulation; otherwise powers count from the
        floor.
    overrides: values that were set, by dotted key.
    """

    source: Path
    scenario: Scenario
    rows: tuple[Row, ...]
    pulses: int
    blocks: tuple[int, int]
    profile_m: Float[np.ndarray, " cell"]
    profiles: tuple[Float[np.ndarray, " cell"], Float[np.ndarray, " cell"]]
    levels_known: bool
    overrides: Mapping[str, Any]
    warnings: tuple[str, ...]

    def row(self, name: str) -> Row:
        """Return a row by its name."""
        return next(row for row in self.rows if row.name == name)

    @property
    def differing(self) -> tuple[str, ...]:
        """Names of the rows that differ."""
        return tuple(row.name for row in self.rows if row.differs)


def twin(
    recording: str | Path,
    *,
    terrain: str | Path | None = None,
    base: str | Path | None = None,
    overrides: Mapping[str, Any] | None = None,
) -> Twin:
    """Fly the poses of a recording over a reference, and compare what was measured with what is simulated.

    With errors in `[platform.navigation]` the recorded poses are those that the navigation reports, and the simulated
    beams leave from others, by errors drawn from the twin's seed.

    Parameters
    ----------
    recording:
        As for `process`, with poses.
    terrain:
        Elevation raster of the ground; None for that of the scenario.
    base:
        Scenario of the radar and the ground's material, for a recording without one.
    overrides:
        Values by dotted key: `processing` and `dem` apply to both sides, all others to the simulation.

    Returns
    -------
    Rows that compare what was measured with what was simulated, and the mean profiles of both.

    Raises
    ------
    InputFileError, ScenarioError
        No poses, no scenario, another sweep than the recorded one, or a flight that leaves the reference.

    Examples
    --------
    >>> run(load_scenario("hills", {"platform.length_m": 10.0}), recordings={"signals": "flown.nc"}).pulses
    100
    >>> twin("flown.nc").differing
    ()
    """
    changes = dict(overrides or {})
    both = {key: value for key, value in changes.items() if key.split(".")[0] in PROCESSED_KEYS}
    with open_recording(Path(recording), both) as source:
        return replace(_twin(source, _scenario(source, base, changes), terrain), overrides=changes)


def _scenario(source: RecordingSource, base: str | Path | None, changes: dict[str, Any]) -> Scenario:
    """Return the scenario to simulate: the recorded one or the base, with the recording's sweep."""
    if isinstance(source.settings, Scenario) and base is None:
        scenario = source.settings.replace(changes)
    elif base is not None and isinstance(source.file, DescribedRanges):
        scenario = load_scenario(base, changes)
    elif base is not None:
        chirp = source.sweeps[0]
        sent = {
            "radar.carrier_hz": chirp.carrier_hz,
            "radar.bandwidth_hz": chirp.bandwidth_hz,
            "radar.chirp_rate_hz": chirp.rate_hz / len(source.sweeps),
            "radar.samples_per_chirp": chirp.samples,
            "radar.sampling": chirp.sampling,
            "radar.sweep": "triangular" if len(source.sweeps) > 1 else chirp.sweep,
        }
        scenario = load_scenario(base, sent | changes)
    else:
        message = "is needed: this recording does not say what radar and ground it is of; give a file or a shipped name"
        raise ScenarioError.of("--base", message, str(source.path))
    if scenario.sensor != "radar":
        message = f"{scenario.sensor!r} has no beat signals to compare; set sensor = 'radar'"
        raise ScenarioError.of("sensor", message, str(source.path))
    if not isinstance(source.file, DescribedRanges):
        check_same_radar(build_sweeps(scenario.radar), source.sweeps, str(source.path))
    scenario = scenario.replace({"processing.calibration": None})
    if "seed" not in changes:
        return scenario.replace({"seed": scenario.seed + 1})
    if isinstance(source.settings, Scenario) and scenario.seed == source.settings.seed:
        message = f"{scenario.seed} is the recording's own, which draws its noise and speckle again; give another one"
        raise ScenarioError.of("seed", message, str(source.path))
    return scenario


@on_one_thread
def _twin(source: RecordingSource, scenario: Scenario, terrain: str | Path | None) -> Twin:
    file, flight = source.file, source.flight
    if not flight.located:
        message = f"{source.path}: has no poses, which a twin flies; add measured positions, velocities and rotations"
        raise InputFileError(message)
    if source.angle is not None:
        raise InputFileError(f"{source.path}: holds signals of an array; a twin compares those of one receiver")
    if terrain is not None:
        scenario = over_file(scenario, terrain)
    ours, frame = file.georeference, map_frame(scenario.terrain)
    theirs = None if frame is None else frame.georeference()
    if (ours is None) != (theirs is None):
        which = "recording" if ours is None else "ground"
        message = f"the {which} has no place on the map, and the other has; give a --terrain in the recording's metres"
        raise ScenarioError.of("terrain", message, str(source.path))
    if scenario.platform.navigation.kind == "from_log":
        logger.warning("the log's standard deviations are not in the recording: the twin flies without their errors")
        scenario = scenario.replace({"platform.navigation": {}})
    recorded = flight.pulses(np.arange(len(flight)))
    nominal_m = None if file.flight is None else file.flight.altitude_m
    flown = replace(recorded, measured=_moved(recorded.measured, ours, theirs))
    prepared = prepare(scenario, CustomParts(flight=MeasuredPoseFlight(pulses=flown, nominal_m=nominal_m)))
    return _compared(source, prepared, recorded)


def _moved(pose: Pose, ours: Georeference | None, theirs: Georeference | None) -> Pose:
    """Return poses in other local metres, with heights of the map."""
    if ours is None or theirs is None:
        return pose
    east, north, up = ours.origin_m
    origin = np.array([east, north])
    there = frame_of(theirs)
    assert there is not None
    crs = CRS.from_wkt(ours.crs_wkt)

    def moved(place: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        return np.column_stack(reproject(crs, there.crs, *(place + origin).T)) - there.origin_m

    place = pose.position_m[:, :2]
    # Grid north of the two differs by the convergence.
    step = (moved(place[:1] + np.array([100.0, 0.0])) - moved(place[:1]))[0]
    angle = float(np.arctan2(step[1], step[0]))
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    return Pose(
        position_m=np.column_stack([moved(place), pose.position_m[:, 2] + up]),
        velocity_mps=pose.velocity_mps @ turn.T,
        R_world_antenna=turn @ pose.R_world_antenna,
    )


@dataclass(frozen=True, kw_only=True)
class _Observed:
    """One side by pulses, and its echoes for the map."""

    side: Side
    points: Points
    profiles: Profiles | None


def _look(source: RecordingSource, prepared: Prepared) -> Look:
    pose = prepared.measured(np.arange(len(prepared)))
    hits = prepared.world.caster.cast(pose.position_m, pose.boresight)
    incidence_rad = np.arccos(np.clip(np.abs(hits.cosine), 0.0, 1.0))
    analyser = source.detector.analyser
    shift_m = analyser.chirp.doppler_range_m(pose.boresight_range_rate_mps)
    hit = hits.hit
    beam_rad = max(prepared.instrument.antenna.beamwidths_rad)
    spread_m = np.median(
        hits.distance_m[hit] * beam_rad * np.tan(np.minimum(incidence_rad[hit], np.deg2rad(STEEPEST_DEG)))
    )
    distance_m = np.where(hit, hits.distance_m, np.nan)
    place_m = pose.position_m + np.nan_to_num(distance_m)[:, None] * pose.boresight
    return Look(
        range_m=distance_m,
        bin=(distance_m + shift_m) / analyser.bin_m - analyser.first_bin,
        incidence_deg=np.where(hit, np.rad2deg(incidence_rad), np.nan),
        cover=prepared.world.scene.covers(hits.surface, place_m[:, :2]),
        echo_m=ECHO_CELLS * analyser.chirp.range_resolution_m + ECHO_SPREADS * float(spread_m),
    )


def _observed(
    source: RecordingSource, beats_of: Callable[[Pulses], Beats], look: Look, quiet: Int[np.ndarray, " bin"], what: str
) -> _Observed:
    """Return the statistics of one side, processed with the settings of the recording."""
    analyser = source.detector.analyser
    sensor = source.build_sensor()
    assert isinstance(sensor, RecordedSensor)
    sensor.sweeps = replace(sensor.sweeps, beats=beats_of)
    reach = int(np.ceil(BESIDE_WIDTHS * look.echo_m / analyser.bin_m))
    offsets, leaking = np.arange(-reach, reach + 1), analyser.range_m < _leakage_end_m(source)
    echoes, profiles, floor, leakage, about = [], [], [], [], []
    with stage(what, len(source.flight)):
        for pulses in source.flight.line_blocks(BLOCK_SIZE):
            beats = beats_of(pulses)
            seen = sensor.sweeps.detect(beats, pulses)
            power = analyser.power(beats[0])
            echoes.append(seen.echoes)
            profiles += [] if seen.profiles is None else [seen.profiles]
            # The power of noise is exponential; its median disregards cells with faint echoes.
            floor.append(np.median(power[:, quiet], axis=1) / np.log(2))
            leakage.append(power[:, leaking].mean(axis=1) if leaking.any() else np.zeros(len(power)))
            about.append(_cells_about(power, look.bin[pulses.index], offsets))
            advance(len(pulses))
    told = _range_statistics(source, sensor, Echoes.concatenate(echoes), look)
    side = replace(told.side, floor=np.concatenate(floor), leakage=np.concatenate(leakage), about=np.concatenate(about))
    return _Observed(
        side=side if isinstance(source.settings, Scenario) else side.counted_from_floor(),
        points=told.points,
        profiles=Profiles.concatenate(profiles) if profiles and source.keeps_profiles else None,
    )


def _range_statistics(source: RecordingSource, sensor: Sensor, echoes: Echoes, look: Look) -> _Observed:
    """Return the statistics of the ranges of one side, without its spectra."""
    points, strongest, count = place(echoes, sensor, source.flight), _strongest(echoes), len(source.flight)
    power_db, error_m, nothing = np.full((3, count), np.nan)
    power_db[echoes.pulse[strongest]] = 10 * np.log10(echoes.power[strongest])
    pulse = points.pulse[strongest]
    error_m[pulse] = points.range_m[strongest] - look.range_m[pulse]
    about = np.zeros((count, 0))
    side = Side(floor=nothing, leakage=nothing, about=about, power_db=power_db, error_m=error_m)
    return _Observed(side=side, points=points, profiles=None)


def _readings(source: RecordingSource, prepared: Prepared, look: Look) -> tuple[_Observed, _Observed]:
    """Return the ranges that were read, and those that the simulated radar reads: of its strongest echoes."""
    simulator, file = prepared.build_sensor(), source.file
    assert isinstance(file, DescribedRanges)
    echoes: list[Echoes] = []
    with stage("tracing", len(source.flight)):
        for pulses in prepared.flight.line_blocks(BLOCK_SIZE):
            echoes.append(simulator.observe(pulses).echoes)
            advance(len(pulses))
    found, range_m = Echoes.concatenate(echoes), np.full(len(source.flight), np.nan)
    points, strongest = place(found, simulator, source.flight), _strongest(found)
    range_m[points.pulse[strongest]] = points.range_m[strongest]
    every = source.flight.pulses(np.arange(len(source.flight)))
    read, simulated = (
        _range_statistics(source, sensor, sensor.observe(every).echoes, look)
        for sensor in (RangeReadings(file, source.errors), RangeReadings(replace(file, range_m=range_m)))
    )
    return read, simulated


def _quiet(source: RecordingSource, sides: Sequence[Callable[[Pulses], Beats]]) -> Int[np.ndarray, " bin"]:
    """Return the bins that hold the floor: the quietest of both sides together, lest one of them be favoured."""
    analyser, pulses = source.detector.analyser, source.flight.sample(SPECTRUM_PULSES)
    level = np.prod([np.median(analyser.power(beats(pulses)[0]), axis=0) for beats in sides], axis=0)
    level[analyser.range_m < _leakage_end_m(source)] = np.inf
    return np.sort(np.argsort(level)[: max(1, int(QUIETEST * len(level)))])


def _leakage_end_m(source: RecordingSource) -> float:
    """Return the range limit of leakage: nearer than any echo, and at least the window's response."""
    return max(source.detector.min_range_m, RESPONSE_CELLS * source.detector.analyser.chirp.range_resolution_m)


def _cells_about(
    power: Float[np.ndarray, "pulse bin"], at: Float[np.ndarray, " pulse"], offsets: Int[np.ndarray, " cell"]
) -> Float[np.ndarray, "pulse cell"]:
    centre = np.where(np.isfinite(at), np.rint(at), -1e9).astype(np.int64)
    column = centre[:, None] + offsets
    inside = (column >= 0) & (column < power.shape[1])
    cells = np.take_along_axis(power, np.where(inside, column, 0), axis=1)
    return np.where(inside, cells, np.nan)


def _strongest(echoes: Echoes) -> Int[np.ndarray, " pulse"]:
    """Return the row of the strongest echo of each pulse that has one."""
    order = np.lexsort((-echoes.power, echoes.pulse))
    _, first = np.unique(echoes.pulse[order], return_index=True)
    return order[first]


def _compared(source: RecordingSource, prepared: Prepared, recorded: Pulses) -> Twin:
    count = len(source.flight)
    if count < (least := MIN_TILE_PULSES << MIN_HALVINGS):
        raise InputFileError(f"{source.path}: has {count} pulses; {least} at least can be compared")
    look = _look(source, prepared)
    block = _tiles(look, recorded.measured, max(prepared.instrument.antenna.beamwidths_rad))
    blocks, readings = int(block.max()) + 1, isinstance(source.file, DescribedRanges)
    measured, simulated = (_readings if readings else _signals)(source, prepared, look)
    analyser = source.detector.analyser
    pair = Pair(
        measured=measured.side,
        simulated=simulated.side,
        look=look,
        block=block,
        scan=source.flight.scan_numbers,
        bin_m=analyser.bin_m,
        chirp=analyser.chirp,
        beam_rad=max(prepared.instrument.antenna.beamwidths_rad),
        levels_known=isinstance(source.settings, Scenario),
    )
    statistics = ([] if readings else [*power_rows(pair), *shape_rows(pair)]) + range_rows(pair)
    statistics += _of_maps(source, prepared, pair, (measured, simulated), recorded)
    abouts = measured.side.about, simulated.side.about
    sampled = np.logical_and.reduce([np.isfinite(about).any(axis=0) for about in abouts])
    return Twin(
        source=source.path,
        scenario=prepared.scenario,
        rows=rows_of(statistics, blocks, prepared.scenario.seed),
        pulses=count,
        blocks=(blocks, count // blocks),
        profile_m=(np.flatnonzero(sampled) - len(sampled) // 2) * analyser.bin_m,
        profiles=(np.nanmean(abouts[0][:, sampled], axis=0), np.nanmean(abouts[1][:, sampled], axis=0)),
        levels_known=readings or pair.levels_known,
        overrides={},
        warnings=source.file.warnings + prepared.warnings,
    )


def _signals(source: RecordingSource, prepared: Prepared, look: Look) -> tuple[_Observed, _Observed]:
    """Return the statistics of the recorded and of the simulated signals, both processed as the recording is."""
    simulator = prepared.build_sensor()
    assert isinstance(simulator, Radar)

    def simulated_beats(pulses: Pulses) -> Beats:
        return simulator.sweeps.beats(prepared.flight.pulses(pulses.index))

    quiet = _quiet(source, (source.beats, simulated_beats))
    measured = _observed(source, source.beats, look, quiet, "reading")
    return measured, _observed(source, simulated_beats, look, quiet, "tracing")


def _tiles(look: Look, pose: Pose, beam_rad: float) -> Int[np.ndarray, " pulse"]:
    """Return the tile of the ground that each pulse looks at: halves of halves along their longer side.

    Beams of the same ground, of one scan or of several, are in one tile. A pulse that meets nothing belongs to the
    tile of the one before.
    """
    hit = np.flatnonzero(np.isfinite(look.range_m))
    if len(hit) < MIN_TILE_PULSES << MIN_HALVINGS:
        raise InputFileError(f"{len(hit)} of the beams meet the ground; fly over it, or give a larger --terrain")
    place_m = (pose.position_m + look.range_m[:, None] * pose.boresight)[hit, :2]
    footprint_m = float(np.median(look.range_m[hit]) * beam_rad)
    tile = np.zeros(len(hit), dtype=np.int64)
    for halvings in range(MAX_HALVINGS):
        halved = tile.copy()
        for number in range(1 << halvings):
            own = np.flatnonzero(tile == number)
            axis = int(np.argmax(np.ptp(place_m[own], axis=0)))
            order = own[np.argsort(place_m[own, axis], kind="stable")]
            halved[order[len(order) // 2 :]] += 1 << halvings
        across_m = [float(np.hypot(*np.ptp(place_m[halved == number], axis=0))) for number in range(2 << halvings)]
        small = np.median(across_m) < TILE_FOOTPRINTS * footprint_m or len(hit) < MIN_TILE_PULSES * len(across_m)
        if halvings >= MIN_HALVINGS and small:
            break
        tile = halved
    whole = np.searchsorted(hit, np.arange(len(look.range_m)), side="right") - 1
    return tile[np.maximum(whole, 0)]


def _of_maps(
    source: RecordingSource, prepared: Prepared, pair: Pair, both: tuple[_Observed, _Observed], recorded: Pulses
) -> list[Statistic]:
    if not len(both[0].points):
        return []
    mapper = source.mapper_of(both[0].points)
    with stage("mapping"):
        dems = [mapper.map(one.points, one.profiles, source.file.pose).dem for one in both]
    filled, grid = dems[0].filled & dems[1].filled, dems[0].grid
    reference_m = _reference_heights(source, prepared, dems[0])[filled]
    hit, row_column = np.isfinite(pair.look.range_m), np.nonzero(filled)
    beams_m = recorded.measured.position_m + pair.look.range_m[:, None] * recorded.measured.boresight
    cells = np.column_stack([grid.x_m[row_column[1]], grid.y_m[row_column[0]]])
    _, nearest = KDTree(beams_m[hit, :2]).query(cells)
    errors = [dem.height_m[filled] - reference_m for dem in dems]
    down = float(np.median(-recorded.measured.boresight[hit, 2]))
    return dem_rows(errors[0], errors[1], pair.block[hit][nearest], down)


def _reference_heights(source: RecordingSource, prepared: Prepared, dem: Raster) -> Float[np.ndarray, "row column"]:
    """Return the heights of the reference at the cells of a DEM, in the recording's metres."""
    x, y = np.meshgrid(dem.grid.x_m, dem.grid.y_m)
    nothing = np.zeros((x.size, 3))
    place = np.column_stack([x.ravel(), y.ravel(), nothing[:, 0]])
    ours, theirs = source.file.georeference, prepared.world.scene.georeference
    there = _moved(
        Pose(position_m=place, velocity_mps=nothing, R_world_antenna=np.zeros((len(place), 3, 3))), ours, theirs
    )
    rise_m = 0.0 if ours is None or theirs is None else theirs.origin_m[2] - ours.origin_m[2]
    return (prepared.world.top_m(there.position_m[:, :2]) + rise_m).reshape(x.shape)
