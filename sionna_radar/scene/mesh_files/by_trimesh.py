"""Triangles of mesh files as trimesh reads them: as they are, with nothing merged, and from the bytes given alone."""

import io
import warnings
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from sionna_radar.scene.mesh_files.part import MOST_FACES, MOST_VERTICES, MeshError, MeshPart, check_count
from sionna_radar.scene.mesh_files.polygons import check_indices


def read_by_trimesh(data: bytes, kind: str, beside: Mapping[str, bytes] | None = None) -> tuple[MeshPart, ...]:
    """Return the triangles of a file, one part for each mesh of each node.

    Parameters
    ----------
    data:
        The whole file; what it claims must have been checked against its bytes.
    kind:
        Its format, by the name trimesh has for it.
    beside:
        All other files that trimesh may have, by the names it asks for.

    Raises
    ------
    MeshError
        It cannot be read.

    """
    import trimesh

    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("error", module=r"trimesh\.")
            warnings.simplefilter("ignore", RuntimeWarning)  # vertices that are no places are found later
            scene = trimesh.load_scene(
                io.BytesIO(data),
                file_type=kind,
                resolver=dict(beside or {}),  # whatever is not in it cannot be opened
                allow_remote=False,
                process=False,
                **({"skip_materials": True, "fix_texture": False} if kind == "ply" else {}),
            )
            return tuple(_parts(scene))
    except MeshError:
        raise
    except Exception as error:  # trimesh raises whatever it meets
        reason = str(error).splitlines()[0][:100] if str(error) else type(error).__name__
        message = f"cannot be read as {kind.upper()} ({reason}); export it again"
        raise MeshError(message) from error


def _parts(scene: Any) -> Iterator[MeshPart]:
    import trimesh

    vertex_count = face_count = 0
    for node in scene.graph.nodes_geometry:
        place, name = scene.graph[node]
        mesh = scene.geometry[name]
        if not isinstance(mesh, trimesh.Trimesh):  # points and lines
            continue
        vertex_count, face_count = vertex_count + len(mesh.vertices), face_count + len(mesh.faces)
        check_count(vertex_count, MOST_VERTICES, "vertices")
        check_count(face_count, MOST_FACES, "triangles")
        faces = np.array(mesh.faces, dtype=np.int64)
        check_indices(faces, len(mesh.vertices))
        if np.linalg.det(place[:3, :3]) < 0:  # a mirrored copy
            faces = faces[:, ::-1]
        vertices = np.array(mesh.vertices, dtype=np.float64)
        if not np.array_equal(place, np.eye(4)):
            vertices = vertices @ place[:3, :3].T + place[:3, 3]
        material = getattr(getattr(mesh.visual, "material", None), "name", None)
        yield MeshPart(name=str(material or mesh.metadata.get("name") or ""), vertices=vertices, faces=faces)
