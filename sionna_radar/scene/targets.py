"""Targets of a scene: points, tables of cross-sections, and bodies from meshes."""

import csv
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from sionna_radar.foundation.errors import InputFileError, Problem, ScenarioError
from sionna_radar.foundation.input_file import read_text, shown
from sionna_radar.scene.mesh_files.repair import repair
from sionna_radar.scene.model import Body
from sionna_radar.scene.motion import RcsTable, Way
from sionna_radar.scene.objects import MeshSource, upright

AZIMUTH, ELEVATION, RCS = "azimuth_deg", "elevation_deg", "rcs_dbsm"
REMEDY = f"give a CSV file with the columns {AZIMUTH},{RCS}, and {ELEVATION} if it depends on that"
MAX_ROWS = 1_000_000


def read_rcs(path: Path) -> RcsTable:
    """Return the table in a file; raises InputFileError for any other file."""
    rows = [line for line in read_text(path, "rcs_table", REMEDY).splitlines() if line.strip() and line[0] != "#"]
    try:
        header = [name.strip() for name in next(csv.reader(rows[:1]), [])]
        values = [[float(cell) for cell in row] for row in csv.reader(rows[1:])]
        _check(header, values)
        return _table(header, np.array(values))
    except (ValueError, csv.Error) as error:
        message = f"{shown(path)} holds no radar cross-section by angle ({error}); {REMEDY}"
        raise InputFileError(message) from error


def _check(header: list[str], values: list[list[float]]) -> None:
    """Raise ValueError for other columns, for too many rows or none, and for non-finite values."""
    if set(header) not in ({AZIMUTH, RCS}, {AZIMUTH, ELEVATION, RCS}) or len(set(header)) != len(header):
        message = f"its header is {shown(','.join(header))}"
        raise ValueError(message)
    if not 1 <= len(values) <= MAX_ROWS or any(len(row) != len(header) for row in values):
        message = f"its rows are not from 1 to {MAX_ROWS:,} of {len(header)} numbers each"
        raise ValueError(message)
    if not np.all(np.isfinite(values)):
        message = "not all of its numbers are finite"
        raise ValueError(message)


def _table(header: list[str], values: Float[np.ndarray, "row column"]) -> RcsTable:
    azimuth, rcs_db = values[:, header.index(AZIMUTH)], values[:, header.index(RCS)]
    elevation = values[:, header.index(ELEVATION)] if ELEVATION in header else np.zeros(len(values))
    if np.ptp(azimuth) >= 360 or np.abs(elevation).max() > 90 or np.abs(rcs_db).max() > 200:
        message = "azimuths cover a turn or more (leave out the last), elevations exceed 90, or levels 200 dB"
        raise ValueError(message)
    columns, column = np.unique(azimuth, return_inverse=True)
    heights, row = np.unique(elevation, return_inverse=True)
    if len(columns) * len(heights) != len(values) or len(set(zip(row, column, strict=True))) != len(values):
        message = "there is not one row for each azimuth at each elevation"
        raise ValueError(message)
    rcs_m2 = np.empty((len(heights), len(columns)))
    rcs_m2[row, column] = 10 ** (rcs_db / 10)
    return RcsTable(azimuth_rad=np.deg2rad(columns), elevation_rad=np.deg2rad(heights), rcs_m2=rcs_m2)


# Over a face of side s at range r the two-way phase error of the plane-wave approximation is pi s^2 / (2 wavelength r)
# at its corners: pi / 8 at this range.
NEAREST_M = 10.0
MAX_FACES = 200_000


def body_of(source: MeshSource, key: str, wavelength_m: float, reflectivity: float = 1.0) -> Body:
    """Return the body of a target.

    reflectivity: of its surface, power over that of a perfect conductor.

    Raises
    ------
    InputFileError
        The mesh cannot be used.
    ScenarioError
        It is so large that it would have too many faces.

    """
    mesh = repair(upright(source, key), f"{key}.path = {shown(source.path)}")
    longest_m = np.sqrt(wavelength_m * NEAREST_M / 4)
    corner = mesh.vertices_m[mesh.faces]
    side_m = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max(axis=1)
    # Halving all sides makes four faces of one.
    halvings = np.ceil(np.log2(np.maximum(side_m / longest_m, 1.0)))
    needed = float((4.0**halvings).sum())
    if needed > MAX_FACES:
        message = (
            f"is of {needed:,.0f} faces of at most {100 * longest_m:.0f} cm, more than {MAX_FACES:,}; give a smaller "
            "or simpler mesh, or set units"
        )
        raise ScenarioError([Problem(f"{key}.path", message)])
    import trimesh

    vertices, faces, owner = trimesh.remesh.subdivide_to_size(
        mesh.vertices_m, mesh.faces, longest_m, max_iter=64, return_index=True
    )
    return Body(
        vertices_m=vertices,
        faces=faces.astype(np.int64),
        two_sided=mesh.two_sided[owner],
        reflectivity=reflectivity,
    )


# Largest step, and largest number of steps, in which a path follows the ground.
STEP_M, MAX_STEPS = 2.0, 20_000


def way_over(
    waypoints_m: Sequence[tuple[float, float]],
    height_m: float,
    speed_mps: float,
    key: str,
    standing_m: Callable[[Float[np.ndarray, "n 2"]], Float[np.ndarray, " n"]],
    *,
    closed: bool,
) -> Way:
    """Return a way along waypoints, at a height above the ground and a speed; ScenarioError where there is none."""
    waypoints = np.array([*waypoints_m, *(waypoints_m[:1] if closed else [])])
    length_m = np.linalg.norm(np.diff(waypoints, axis=0), axis=1)
    step_m = max(STEP_M, float(length_m.sum()) / MAX_STEPS)
    pieces = [
        np.linspace(a, b, max(1, int(np.ceil(leg / step_m))), endpoint=False)
        for a, b, leg in zip(waypoints, waypoints[1:], length_m, strict=False)
    ]
    corner = np.vstack([*pieces, waypoints[-1:]])
    height = standing_m(corner)
    if not np.all(np.isfinite(height)):
        message = "its way leaves the terrain; keep it over ground, or enlarge the terrain"
        raise ScenarioError([Problem(f"{key}.waypoints_m", message)])
    return Way(corner_m=np.column_stack([corner, height + height_m]), speed_mps=speed_mps, closed=closed)
