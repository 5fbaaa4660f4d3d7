"""Point targets of a scenario, placed on the ground."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from sionna_radar.foundation.decibel import from_db
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.scenario.objects import PointTarget, RotorTable
from sionna_radar.scene.body_file import body_of
from sionna_radar.scene.model import Target
from sionna_radar.scene.motion import Rotor, Way
from sionna_radar.scene.rcs_file import read_rcs

AXES = {"forward": (1.0, 0.0, 0.0), "right": (0.0, 1.0, 0.0), "up": (0.0, 0.0, 1.0)}
# A way follows the ground in steps no longer than this, and in no more of them.
STEP_M, MOST_STEPS = 2.0, 20_000


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
        Height of the ground where it stands.
    standing_m:
        Returns that at other places.
    wavelength_m:
        Of the carrier, which decides how finely a body is divided.

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
    places = np.array([table.position_m, *table.waypoints_m, *([table.position_m] if table.closed else [])])
    length_m = np.linalg.norm(np.diff(places, axis=0), axis=1)
    step_m = max(STEP_M, float(length_m.sum()) / MOST_STEPS)
    pieces = [
        np.linspace(a, b, max(1, int(np.ceil(leg / step_m))), endpoint=False)
        for a, b, leg in zip(places, places[1:], length_m, strict=False)
    ]
    corner = np.vstack([*pieces, places[-1:]])
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
