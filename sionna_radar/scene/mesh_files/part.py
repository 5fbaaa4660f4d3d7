"""What every reader of a mesh file returns, and the bounds all keep."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.foundation.input_file import shown

MOST_BYTES = 2_000_000_000
# Numbers as text take several times their bytes in memory while they are read.
MOST_TEXT_BYTES = 200_000_000
MOST_VERTICES = 20_000_000
MOST_FACES = 20_000_000
MOST_PARTS = 100_000


class MeshError(ValueError):
    """What is wrong with a mesh file and what to give instead; the caller adds the file's name."""


@dataclass(frozen=True, kw_only=True)
class MeshPart:
    """The triangles of one material, in the file's own axes and units.

    name: the material's own name, or the object's where it has none; empty if the file names neither.
    """

    name: str
    vertices: Float[np.ndarray, "vertex 3"]
    faces: Int[np.ndarray, "face 3"]


def check_count(count: int, most: int, what: str) -> None:
    """Raise MeshError for more of something than can be used."""
    if count > most:
        message = f"has {count:,} {what}, more than {most:,}; simplify the mesh, or cut out the part that is flown"
        raise MeshError(message)


def beside(path: Path, name: str, place: str) -> Path:
    """Return a file that another one names; it must lie in that one's own folder, links followed.

    Raises MeshError, with the place where the name stands.
    """
    inner = Path(name.replace("\\", "/"))
    remedy = "a mesh may only name files of its own folder; put it there, or convert the mesh to one GLB file"
    if not name or "\0" in name or "://" in name or inner.is_absolute() or ".." in inner.parts or ":" in name[:3]:
        message = f"{place} names {shown(name)}; {remedy}"
        raise MeshError(message)
    try:
        folder, found = path.parent.resolve(), (path.parent / inner).resolve()
    except (OSError, RuntimeError, ValueError) as error:
        message = f"{place} names {shown(name)}, which cannot be reached; {remedy}"
        raise MeshError(message) from error
    if not found.is_relative_to(folder):
        message = f"{place} names {shown(name)}, a link to elsewhere; {remedy}"
        raise MeshError(message)
    return found
