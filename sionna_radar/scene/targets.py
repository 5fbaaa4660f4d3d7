"""Targets of a scene: points, tables of cross-sections, and bodies from meshes."""

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float

from sionna_radar.foundation.errors import InputFileError, Problem, ScenarioError
from sionna_radar.foundation.input_file import read_text, shown
from sionna_radar.foundation.numerics import from_db
from sionna_radar.scenario.objects import PointTarget, RotorTable, TargetMesh
from sionna_radar.scene.mesh_files.repair import repair
from sionna_radar.scene.model import Body, Target
from sionna_radar.scene.motion import RcsTable, Rotor, Way
from sionna_radar.scene.objects import upright

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


def body_of(table: TargetMesh, key: str, wavelength_m: float) -> Body:
    """Return the body of a target.

    Raises
    ------
    InputFileError
        The mesh cannot be used.
    ScenarioError
        It is so large that it would have too many faces.

    """
    mesh = repair(upright(table, key), f"{key}.path = {shown(table.path)}")
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
        reflectivity=from_db(table.reflectivity_db),
    )


AXES = {"forward": (1.0, 0.0, 0.0), "right": (0.0, 1.0, 0.0), "up": (0.0, 0.0, 1.0)}
# Largest step, and largest number of steps, in which a path follows the ground.
STEP_M, MAX_STEPS = 2.0, 20_000


def target_of(
    table: PointTarget,
    key: str,
    ground_m: float,
    standing_m: Callable[[Float[np.ndarray, "n 2"]], Float[np.ndarray, " n"]],
    wavelength_m: float,
) -> Target:
    """Return a target over the ground.

    Parameters
    ----------
    table, key:
        The target in the scenario, and its dotted key.
    ground_m:
        Height of the ground at its position.
    standing_m:
        Returns the ground height at horizontal positions.
    wavelength_m:
        Of the carrier; sets the subdivision of a body.

    Raises
    ------
    ScenarioError
        It stands, or moves, beyond the terrain.
    InputFileError
        Its table of cross-sections, or its mesh, cannot be read.

    """
    if not np.isfinite(ground_m):
        message = f"{table.position_m} is beyond the terrain; move it or enlarge the terrain"
        raise ScenarioError([Problem(f"{key}.position_m", message)])
    return Target(
        position_m=(*table.position_m, ground_m + table.height_m),
        rcs_m2=0.0 if table.rcs_dbsm is None else from_db(table.rcs_dbsm),
        swerling=table.swerling,
        way=_way(table, key, standing_m),
        heading_rad=float(np.deg2rad(table.heading_deg)),
        rcs_table=None if table.rcs_table is None else read_rcs(table.rcs_table),
        rotors=tuple(_rotor(rotor) for rotor in table.rotors),
        body=None if table.mesh is None else body_of(table.mesh, f"{key}.mesh", wavelength_m),
    )


def _way(
    table: PointTarget, key: str, standing_m: Callable[[Float[np.ndarray, "n 2"]], Float[np.ndarray, " n"]]
) -> Way | None:
    if table.speed_mps is None:
        return None
    waypoints = np.array([table.position_m, *table.waypoints_m, *([table.position_m] if table.closed else [])])
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
    return Way(
        corner_m=np.column_stack([corner, height + table.height_m]), speed_mps=table.speed_mps, closed=table.closed
    )


def _rotor(table: RotorTable) -> Rotor:
    return Rotor(
        offset_m=table.offset_m,
        axis=AXES[table.axis],
        radius_m=table.radius_m,
        turns_per_s=table.rotation_rpm / 60,
        blades=table.blades,
        points=table.points,
        rcs_m2=from_db(table.rcs_dbsm),
    )
