"""Reading of mesh files of all formats, by file extension."""

import warnings
from pathlib import Path

import numpy as np

from sionna_radar.foundation.city_models import refuse_city_model
from sionna_radar.foundation.errors import InputFileError, RadarError, reason_of
from sionna_radar.foundation.input_file import regular_file, shown
from sionna_radar.scene.mesh_files.gltf import read_gltf
from sionna_radar.scene.mesh_files.mitsuba_xml import read_mitsuba
from sionna_radar.scene.mesh_files.obj_and_stl import read_obj, read_stl
from sionna_radar.scene.mesh_files.part import MAX_BYTES, MeshError, MeshPart
from sionna_radar.scene.mesh_files.ply import read_ply

READERS = {
    ".ply": read_ply,
    ".obj": read_obj,
    ".stl": read_stl,
    ".glb": read_gltf,
    ".gltf": read_gltf,
    ".xml": read_mitsuba,
}
REMEDY = f"give a mesh: {', '.join(READERS)} (.xml: a scene of Mitsuba 3 or Sionna RT)"
# The up axis of formats that define it; others are z up, as most CAD and survey exports are.
UP = {".glb": "y", ".gltf": "y"}


def read_mesh(path: Path, key: str) -> tuple[MeshPart, ...]:
    """Return the triangles of a mesh file, in its own axes and units, as float64.

    path: the file: PLY, OBJ, STL, GLB, glTF, or an XML scene of Mitsuba or Sionna.
    key: the scenario's key that names it, for messages.

    Raises InputFileError if it is of another format, too large or damaged, or names files outside its folder.
    """
    name = f"{key} ="
    size = regular_file(path, name, REMEDY, MAX_BYTES)
    refuse_city_model(path, name)
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise InputFileError(f"{name} {shown(path)} ends in {shown(path.suffix)}; {REMEDY}")
    if size == 0:
        raise InputFileError(f"{name} {shown(path)} is empty; get the whole file")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # numbers too large for float32 and the like
            parts = reader(path)
    except RadarError:
        raise
    except MeshError as error:
        raise InputFileError(f"{name} {shown(path)}: {error}") from error
    except (ValueError, TypeError, LookupError, AttributeError, OverflowError, OSError, RecursionError) as error:
        # Invalid numbers or entries of the wrong type in a damaged file.
        reason = reason_of(error)
        message = f"{name} {shown(path)} cannot be read as {path.suffix[1:].upper()} ({reason}); export it again"
        raise InputFileError(message) from error
    if not any(len(part.faces) for part in parts):
        raise InputFileError(f"{name} {shown(path)}: has no faces; give a mesh of triangles")
    return tuple(
        MeshPart(name=part.name, vertices=np.asarray(part.vertices, dtype=np.float64), faces=part.faces)
        for part in parts
        if len(part.faces)
    )


def up_axis(path: Path) -> str:
    """Return the up axis of a file by its extension: "y" or "z"."""
    return UP.get(path.suffix.lower(), "z")
