"""Reading the body of a target from a mesh file, and dividing it."""

import numpy as np

from sionna_radar.foundation.decibel import from_db
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.input_file import shown
from sionna_radar.scenario.objects import TargetMesh
from sionna_radar.scene.body import Body
from sionna_radar.scene.mesh_files.repair import repair
from sionna_radar.scene.objects import upright

# Over a face of the side s at the range r a plane wave is wrong by pi s^2 / (2 wavelength r) in phase, both ways and at
# its corners: by pi / 8 for this range.
NEAREST_M = 10.0
MOST_FACES = 200_000


def body_of(table: TargetMesh, key: str, wavelength_m: float) -> Body:
    """Return the body of a target.

    Raises
    ------
    InputFileError
        The mesh cannot be used.
    ScenarioError
        It is so large that it would be of too many faces.

    """
    mesh = repair(upright(table, key), f"{key}.path = {shown(table.path)}")
    longest_m = np.sqrt(wavelength_m * NEAREST_M / 4)
    corner = mesh.vertices_m[mesh.faces]
    side_m = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max(axis=1)
    # Halving all sides makes four of a face.
    halvings = np.ceil(np.log2(np.maximum(side_m / longest_m, 1.0)))
    needed = float((4.0**halvings).sum())
    if needed > MOST_FACES:
        message = (
            f"is of {needed:,.0f} faces of at most {100 * longest_m:.0f} cm, more than {MOST_FACES:,}; give a smaller "
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
