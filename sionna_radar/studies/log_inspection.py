"""What is inside a log of a flight, before any scenario exists."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from sionna_radar.flight.logs.cleaning import CleanLog, clean, stretches
from sionna_radar.flight.logs.log import FlightLog, in_metres
from sionna_radar.flight.logs.reader import read_log
from sionna_radar.flight.recorded import course_attitudes, position_spline
from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import shown
from sionna_radar.foundation.raster import Georeference, Grid, Raster
from sionna_radar.scenario.bases import TerrainParameters
from sionna_radar.scene.landscape import TerrainInputs, build_landscape, map_frame

# A terrain is looked at on so many places a side.
PLACES = 300
MIN_MARGIN_M = 50.0
GAP_S = 2.0


@dataclass(frozen=True, kw_only=True)
class LogInspection:
    """A log, and how it lies over a terrain if there is one.

    clean: its positions in metres, and what would keep them from being flown. speed_mps: over the ground.
    euler_deg: roll, pitch and heading at `attitude_s`. ground: heights under it; None without a terrain.
    georeference: of the metres; None where they are the log's own.
    moved_m: by how much east and north the flight was moved to the terrain.
    ground_under_m: height of the terrain under each position, NaN beyond it.
    stretches: from when to when it can be flown, the longest of them.
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

    @property
    def refusals(self) -> tuple[str, ...]:
        """What would be refused, with the times."""
        return tuple(f"at {finding.time_s:.2f} s: {finding.message}" for finding in self.clean.findings)


def inspect_log(
    path: Path,
    terrain: TerrainParameters | None = None,
    *,
    start_s: float = 0.0,
    stop_s: float | None = None,
    gap_s: float = GAP_S,
) -> LogInspection:
    """Read a log, and put it over a terrain.

    Parameters
    ----------
    path:
        The log.
    terrain:
        Ground to show under it. Where the one is on the map and the other is not, the middle of the flight is moved to
        the local origin.
    start_s, stop_s, gap_s:
        As `platform.log_start_s`, `log_stop_s` and `log_gap_s`.

    Raises
    ------
    InputFileError, ScenarioError
        The log or the terrain cannot be read.

    """
    log = read_log(path, "log")
    frame = map_frame(terrain) if terrain is not None else None
    placed = log.on_map and frame is not None
    metric, last_s = in_metres(log, frame if placed else None), np.inf if stop_s is None else stop_s
    part = clean(metric, start_s, last_s, gap_s)
    if len(part.positions.time_s) < 2:
        message = f"log {shown(path)}: has {len(part.positions.time_s)} positions in this part; choose a longer one"
        raise InputFileError(message)
    place = part.positions.place
    moved = None
    if terrain is not None and not placed:
        middle = (place[:, :2].min(axis=0) + place[:, :2].max(axis=0)) / 2
        moved = (-float(middle[0]), -float(middle[1]))
        place = place + np.array([*moved, 0.0])
    velocity = part.positions.velocity_mps
    if velocity is None:
        velocity = position_spline(part.positions, 0.0)(part.positions.time_s, 1)
    attitudes = part.attitudes or course_attitudes(part.positions)
    euler = Rotation.from_quat(attitudes.quaternion).as_euler("ZYX", degrees=True)[:, ::-1]
    ground, georeference, under = _ground(terrain, place)
    raised = 0.0 if georeference is None or not placed else georeference.origin_m[2]
    positions = _moved(part, place - np.array([0.0, 0.0, raised]))
    return LogInspection(
        path=path,
        log=log,
        clean=positions,
        speed_mps=np.hypot(velocity[:, 0], velocity[:, 1]),
        attitude_s=attitudes.time_s,
        euler_deg=euler,
        ground=ground,
        georeference=georeference if placed else None,
        moved_m=moved,
        ground_under_m=under,
        stretches=stretches(metric, start_s, last_s, gap_s) if part.findings else (part.span_s,),
    )


def _moved(part: CleanLog, place: Float[np.ndarray, "n 3"]) -> CleanLog:
    return replace(part, positions=replace(part.positions, place=place))


def _ground(
    terrain: TerrainParameters | None, place: Float[np.ndarray, "n 3"]
) -> tuple[Raster | None, Georeference | None, Float[np.ndarray, " n"] | None]:
    """Return the ground about some places, its georeference, and its height under each."""
    if terrain is None:
        return None, None, None
    low, high = place[:, :2].min(axis=0), place[:, :2].max(axis=0)
    margin = max(0.15 * float(np.max(high - low)), MIN_MARGIN_M)
    west, south, east, north = (float(v) for v in (*(low - margin), *(high + margin)))
    land = build_landscape(terrain, TerrainInputs(window_m=(west, south, east, north), carrier_hz=77e9, channel="VV"))
    grid = Grid.covering(west, south, east, north, max(east - west, north - south) / PLACES)
    heights = land.ground_m(grid.centres_m).reshape(grid.shape)
    under = land.ground_m(place[:, :2])
    return Raster(grid=grid, height_m=heights), land.georeference, under
