"""Inspection of a flight log, without a scenario."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from sionna_radar.flight.log import FlightLog, in_metres
from sionna_radar.flight.log_cleaning import CleanLog, clean, moving_spans, one_time, stretches
from sionna_radar.flight.recorded import course_attitudes, position_spline
from sionna_radar.foundation.bounds import check_bounds
from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import shown
from sionna_radar.foundation.raster import Georeference, Grid, Raster
from sionna_radar.readers.logs.csv_log import AS_THEY_ARE
from sionna_radar.readers.logs.reader import read_log
from sionna_radar.scenario.bases import TerrainParameters
from sionna_radar.scene.landscape import TerrainInputs
from sionna_radar.scene.terrains.build import build_landscape, map_frame

# Cells of the inspected terrain along its longer side.
PLACES = 300
MIN_MARGIN_M = 50.0
GAP_S = 2.0


@dataclass(frozen=True, kw_only=True)
class LogInspection:
    """A log, and its position over a terrain if there is one.

    clean: its positions in metres, and the findings against flying them. speed_mps: over the ground.
    euler_deg: roll, pitch and heading at `attitude_s`. ground: heights below it; None without a terrain.
    georeference: of the metres; None where they are the log's own.
    moved_m: offset east and north of the flight to the terrain.
    ground_under_m: height of the terrain below each position, NaN beyond it.
    stretches: start and end times of the longest flyable parts; moving: of the parts of these in which it moves.
    """

    path: Path
    log: FlightLog
    clean: CleanLog
    speed_mps: Float[np.ndarray, " n"]
    attitude_s: Float[np.ndarray, " m"]
    euler_deg: Float[np.ndarray, "m 3"]
    ground: Raster | None = None
    georeference: Georeference | None = None
    moved_m: tuple[float, float] | None = None
    ground_under_m: Float[np.ndarray, " n"] | None = None
    stretches: tuple[tuple[float, float], ...] = ()
    moving: tuple[tuple[float, float], ...] = ()

    @property
    def refusals(self) -> tuple[str, ...]:
        """Findings against flying the log, with their times."""
        return tuple(f"at {finding.time_s:.2f} s: {finding.message}" for finding in self.clean.findings)


def inspect_log(
    path: str | Path,
    terrain: TerrainParameters | None = None,
    *,
    start_s: float = 0.0,
    stop_s: float | None = None,
    gap_s: float = GAP_S,
    crs: str | None = None,
    columns: Mapping[str, str] = AS_THEY_ARE,
) -> LogInspection:
    """Read a log, and place it over a terrain.

    Parameters
    ----------
    path:
        The log.
    terrain:
        Ground to show below it. If only one of them is georeferenced, the middle of the flight is moved to the local
        origin.
    start_s, stop_s, gap_s:
        As `platform.log_start_s`, `log_stop_s` and `log_gap_s`.
    crs, columns:
        As `platform.log_crs` and `log_columns`.

    Returns
    -------
    Positions in metres, findings against flying the log, and its longest flyable parts in seconds.

    Raises
    ------
    InputFileError, ScenarioError
        The log or the terrain cannot be read.

    Examples
    --------
    >>> from pathlib import Path
    >>> rows = ["time_s,east_m,north_m,up_m", *(f"{k / 10},{k},0,50" for k in range(200))]
    >>> size = Path("flight.csv").write_text(chr(10).join(rows))
    >>> float(inspect_log("flight.csv").speed_mps.mean().round(3))
    10.0
    """
    path = Path(path)
    check_bounds([("start", start_s, 0.0, 1e9), ("stop", stop_s, 0.0, 1e9), ("gap", gap_s, 1e-6, 1e9)])
    log = read_log(path, "log", columns, crs)
    if not float(np.nanmax(log.positions.time_s)) > float(np.nanmin(log.positions.time_s)):
        raise InputFileError(f"log {shown(path)}: {one_time(log)}")
    frame = map_frame(terrain) if terrain is not None else None
    on_map = log.on_map and frame is not None
    metric, last_s = in_metres(log, frame if on_map else None), np.inf if stop_s is None else stop_s
    cleaned = clean(metric, start_s, last_s, gap_s)
    if len(cleaned.positions.time_s) < 2:
        count = len(cleaned.positions.time_s)
        raise InputFileError(f"log {shown(path)}: has {count} distinct time stamps in this part; choose a longer one")
    place = cleaned.positions.place
    offset_m = None
    if terrain is not None and not on_map:
        middle = (place[:, :2].min(axis=0) + place[:, :2].max(axis=0)) / 2
        offset_m = (-float(middle[0]), -float(middle[1]))
        place = place + np.array([*offset_m, 0.0])
    velocity = cleaned.positions.velocity_mps
    if velocity is None:
        velocity = position_spline(cleaned.positions, 0.0)(cleaned.positions.time_s, 1)
    attitudes = cleaned.attitudes or course_attitudes(cleaned.positions)
    euler = Rotation.from_quat(attitudes.quaternion).as_euler("ZYX", degrees=True)[:, ::-1]
    ground, georeference, ground_under_m = _ground(terrain, place)
    origin_height_m = 0.0 if georeference is None or not on_map else georeference.origin_m[2]
    flyable = stretches(metric, start_s, last_s, gap_s) if cleaned.findings else (cleaned.span_s,)
    positions = replace(cleaned.positions, place=place - np.array([0.0, 0.0, origin_height_m]))
    return LogInspection(
        path=path,
        log=log,
        clean=replace(cleaned, positions=positions),
        speed_mps=np.hypot(velocity[:, 0], velocity[:, 1]),
        attitude_s=attitudes.time_s,
        euler_deg=euler,
        ground=ground,
        georeference=georeference if on_map else None,
        moved_m=offset_m,
        ground_under_m=ground_under_m,
        stretches=flyable,
        moving=tuple(span for ends in flyable for span in _moving(cleaned, ends)),
    )


def _moving(log: CleanLog, ends: tuple[float, float]) -> tuple[tuple[float, float], ...]:
    """Return the parts of a stretch in which the vehicle moves."""
    time_s = log.positions.time_s
    return moving_spans(log.positions.rows((time_s >= ends[0]) & (time_s <= ends[1])))


def _ground(
    terrain: TerrainParameters | None, place: Float[np.ndarray, "n 3"]
) -> tuple[Raster | None, Georeference | None, Float[np.ndarray, " n"] | None]:
    """Return the ground around some places, its georeference, and its height below each."""
    if terrain is None:
        return None, None, None
    low, high = place[:, :2].min(axis=0), place[:, :2].max(axis=0)
    margin = max(0.15 * float(np.max(high - low)), MIN_MARGIN_M)
    west, south, east, north = (float(v) for v in (*(low - margin), *(high + margin)))
    land = build_landscape(terrain, TerrainInputs(window_m=(west, south, east, north), carrier_hz=77e9, channel="VV"))
    grid = Grid.covering(west, south, east, north, max(east - west, north - south) / PLACES)
    heights = land.ground_m(grid.centres_m).reshape(grid.shape)
    ground_under_m = land.ground_m(place[:, :2])
    return Raster(grid=grid, height_m=heights), land.georeference, ground_under_m
