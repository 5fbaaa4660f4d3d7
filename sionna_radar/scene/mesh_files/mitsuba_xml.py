"""Reader of Mitsuba 3 and Sionna RT scenes (XML): shapes, transforms and names of materials.

Sionna's own loader runs a scene's plug-ins and reads any file; this one reads only meshes of the scene's folder.
Mitsuba also stores positions as float32, in steps of 0.25 m at a northing of 5,000 km.
"""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from sionna_radar.foundation.input_file import read_text, regular_file, shown
from sionna_radar.scene.mesh_files.obj_and_stl import read_obj
from sionna_radar.scene.mesh_files.part import (
    MAX_BYTES,
    MAX_FACES,
    MAX_PARTS,
    MAX_VERTICES,
    MeshError,
    MeshPart,
    check_count,
    file_in_same_folder,
)
from sionna_radar.scene.mesh_files.ply import read_ply

READERS = {"ply": read_ply, "obj": read_obj}
# Ignored elements: neither surfaces nor references to surfaces.
PASSED_OVER = {
    *("bsdf", "texture", "emitter", "sensor", "integrator", "medium", "default", "rfilter", "film", "sampler"),
    *("string", "float", "integer", "boolean", "rgb", "ref", "volume", "phase", "vector", "point", "spectrum"),
}
# Sionna's loader strips this prefix of a material's name.
MATERIAL_PREFIX = "mat-"
DEEPEST_ELEMENTS = 50
SQUARE = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])


def read_mitsuba(path: Path) -> tuple[MeshPart, ...]:
    """Return the triangles of a Mitsuba scene, one part for each material of each shape; raises MeshError."""
    root = _parsed(path)
    if root.tag != "scene":
        message = f"line {root.line} is <{root.tag}>, not a Mitsuba <scene>; give a scene of Mitsuba 3 or Sionna RT"
        raise MeshError(message)
    parts: list[MeshPart] = []
    names = {e.get("id"): e.get("id") for e in root if e.tag == "bsdf"}
    for element in root:
        if element.tag == "shape":
            parts += _shape(path, element, names)
            check_count(len(parts), MAX_PARTS, "shapes")
            check_count(len(parts[-1].vertices), MAX_VERTICES, "vertices")
        elif element.tag not in PASSED_OVER:
            _refuse(element, f"<{element.tag}> is not read")
    check_count(sum(len(p.faces) for p in parts), MAX_FACES, "triangles")
    if not parts:
        raise MeshError("has no shape; give a scene with shapes of type ply, obj, rectangle or cube")
    return tuple(parts)


def _parsed(path: Path) -> Any:
    """Return the root of a document whose elements have their line numbers."""
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import DefusedXMLParser, ParseError

    class Parser(DefusedXMLParser):
        depth = 0

        def _start(self, tag: str, attributes: list[str]) -> Any:
            """Give an element its line; MeshError for one that lies too deep."""
            self.depth += 1
            if self.depth > DEEPEST_ELEMENTS:
                line = self.parser.CurrentLineNumber
                raise MeshError(f"line {line} lies more than {DEEPEST_ELEMENTS} elements deep; export the scene again")
            element = super()._start(tag, attributes)
            element.line = self.parser.CurrentLineNumber
            return element

        def _end(self, tag: str) -> Any:
            self.depth -= 1
            return super()._end(tag)

    text = read_text(path, "mesh", "give a scene of Mitsuba 3 or Sionna RT")
    parser = Parser(forbid_dtd=True)
    try:
        parser.feed(text)
        return parser.close()
    except DefusedXmlException as error:
        raise MeshError("has a document type or entities, which no scene needs; remove them") from error
    except ParseError as error:
        raise MeshError(f"is not XML ({error}); correct it there") from error


def _refuse(element: Any, reason: str) -> None:
    raise MeshError(f"line {element.line}: {reason}; remove it, or convert the scene to one GLB or PLY file")


def _shape(path: Path, shape: Any, names: dict[str, str]) -> list[MeshPart]:
    kind = shape.get("type", "")
    transform, flipped = _transform(shape), _value(shape, "flip_normals", "boolean") == "true"
    if kind in READERS:
        parts = READERS[kind](_file(path, shape))
    elif kind == "rectangle":
        parts = (MeshPart(name="", vertices=SQUARE, faces=np.array([[0, 1, 2], [0, 2, 3]])),)
    elif kind == "cube":
        parts = (_cube(),)
    else:
        _refuse(shape, f"a shape of type {shown(kind)} is not read (ply, obj, rectangle and cube are)")
    material = _material(shape, names)
    if np.linalg.det(transform[:3, :3]) < 0:
        flipped = not flipped
    return [
        MeshPart(
            name=material or part.name or shape.get("id", ""),
            vertices=part.vertices @ transform[:3, :3].T + transform[:3, 3],
            faces=part.faces[:, ::-1] if flipped else part.faces,
        )
        for part in parts
    ]


def _cube() -> MeshPart:
    import trimesh

    box = trimesh.creation.box(extents=(2.0, 2.0, 2.0))
    return MeshPart(
        name="", vertices=np.array(box.vertices, dtype=np.float64), faces=np.array(box.faces, dtype=np.int64)
    )


def _file(path: Path, shape: Any) -> Path:
    name, label = _value(shape, "filename", "string"), f"line {shape.line}"
    file = file_in_same_folder(path, name, label)
    regular_file(file, f"{label} of {shown(path)} names", "put it into the scene's folder", MAX_BYTES)
    return file


def _value(element: Any, name: str, kind: str) -> str:
    return next((e.get("value", "") for e in element if e.tag == kind and e.get("name") == name), "")


def _material(shape: Any, names: dict[str, str]) -> str:
    """Return the name of a shape's material, referenced or nested."""
    for element in shape:
        if element.tag == "bsdf":
            inner = [e.get("id", "") for e in element.iter("bsdf")]
            return next((name.removeprefix(MATERIAL_PREFIX) for name in inner if name), "")
        if element.tag == "ref" and (element.get("name") == "bsdf" or element.get("id") in names):
            if element.get("id") not in names:
                _refuse(element, f"there is no material {shown(element.get('id'))}")
            return str(element.get("id")).removeprefix(MATERIAL_PREFIX)
    return ""


def _transform(shape: Any) -> Float[np.ndarray, "4 4"]:
    transform = np.eye(4)
    for element in shape:
        if element.tag == "transform" and element.get("name") == "to_world":
            for step in element:
                transform = _step(step) @ transform
    return transform


def _step(step: Any) -> Float[np.ndarray, "4 4"]:
    matrix = np.eye(4)
    if step.tag == "translate":
        matrix[:3, 3] = _numbers(step, 0.0)
    elif step.tag == "scale":
        matrix[:3, :3] = np.diag(_numbers(step, 1.0))
    elif step.tag == "rotate":
        axis = _numbers(step, 0.0)
        length = np.linalg.norm(axis)
        if length == 0:
            _refuse(step, "a rotation has no axis")
        turn = np.deg2rad(_floats(step, step.get("angle", "0"), (1,))[0])
        matrix[:3, :3] = Rotation.from_rotvec(turn * axis / length).as_matrix()
    elif step.tag == "matrix":
        values = _floats(step, step.get("value", ""), (9, 16))
        side = int(np.sqrt(len(values)))
        matrix[:side, :side] = values.reshape(side, side)
    else:
        _refuse(step, f"a transform by <{step.tag}> is not read")
    return matrix


def _numbers(step: Any, default: float) -> Float[np.ndarray, " 3"]:
    """Return the x, y and z of a step, or its one value."""
    if step.get("value") is not None:
        values = _floats(step, step.get("value"), (1, 3))
        return np.broadcast_to(values, 3).astype(np.float64)
    return np.array([_floats(step, step.get(axis, str(default)), (1,))[0] for axis in "xyz"])


def _floats(step: Any, text: str, allowed: tuple[int, ...]) -> Float[np.ndarray, " n"]:
    try:
        values = np.array([float(word) for word in text.replace(",", " ").split()])
    except ValueError:
        values = np.zeros(0)
    if len(values) not in allowed or not np.isfinite(values).all():
        _refuse(step, f"{shown(text)} is not {' or '.join(map(str, allowed))} number(s)")
    return values
