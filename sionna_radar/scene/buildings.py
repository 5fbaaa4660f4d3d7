"""Box buildings that stand on the ground."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.scenario.objects import Building
from sionna_radar.scene.model import Surface


def build_box(
    building: Building, index: int, ground_m: Callable[[Float[np.ndarray, "n 2"]], Float[np.ndarray, " n"]]
) -> Surface:
    """Return a building as a box: its base on the lowest ground in its outline, its height above that.

    Raises
    ------
    ScenarioError
        Part of the outline is outside the terrain.

    """
    length, width, height = building.size_m
    heading = np.deg2rad(building.heading_deg)
    along, across = np.array([np.sin(heading), np.cos(heading)]), np.array([np.cos(heading), -np.sin(heading)])
    share = np.linspace(-0.5, 0.5, 21)
    a, b = (grid.ravel()[:, None] for grid in np.meshgrid(share * length, share * width))
    base = float(np.min(ground_m(np.array(building.position_m) + a * along + b * across)))
    if not np.isfinite(base):
        message = f"the building at {building.position_m} extends beyond the terrain; move it or enlarge the terrain"
        raise ScenarioError([Problem(f"buildings.{index}.position_m", message)])
    place = np.eye(4)
    place[:2, 0], place[:2, 1] = across, along
    place[:3, 3] = [*building.position_m, base + height / 2]
    # It takes a tenth of a second to import, and most scenes have no boxes.
    import trimesh

    box = trimesh.creation.box(extents=(width, length, height), transform=place)
    return Surface(
        name=f"building-{index}",
        vertices_m=np.asarray(box.vertices, dtype=np.float64),
        faces=np.asarray(box.faces, dtype=np.int64),
        material=building.material,
    )
