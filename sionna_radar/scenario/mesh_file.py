"""What `[terrain]` of kind "mesh" and `[[objects]]` share: a file of triangles, its axes, size and materials."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import model_validator

from sionna_radar.scenario.table import InputPath, Positive, Real, Table

Unit = Literal["m", "cm", "mm", "km", "in", "ft", "ftUS", "yd"]
METRES = {
    "m": 1.0,
    "cm": 0.01,
    "mm": 0.001,
    "km": 1000.0,
    "in": 0.0254,
    "ft": 0.3048,
    "ftUS": 1200 / 3937,
    "yd": 0.9144,
}


class MeshShape(Table):
    """A file of triangles: PLY, OBJ, STL, GLB, glTF, or an XML scene of Mitsuba or Sionna.

    path: the file.
    units: of its coordinates.
    up: its axis that points up; without it y of GLB and glTF, whose standard says so, and z of all others.
    scale: what it is enlarged by besides.
    heading_deg: clockwise turn of its y axis (of -z where y is up) from north; on a target from the target's front.
    """

    path: InputPath
    units: Unit = "m"
    up: Literal["y", "z"] | None = None
    scale: Positive = 1.0
    heading_deg: Real = 0.0

    @property
    def metres_per_unit(self) -> float:
        """Metres of one unit of the file's coordinates, the scale included."""
        return METRES[self.units] * self.scale


class MeshFile(MeshShape):
    """A file of triangles, with what it is made of.

    material: of all of it but what `materials` names; a table is taken for `materials`.
    materials: materials of the scenario by the mesh's own material names (without Sionna's "mat-"), or by the names of
        its objects where these have no material.
    centre: what of it stands at `position_m`: the file's origin, or the middle of its box in plan, at its lowest point,
        for files whose coordinates are far from their origin.
    """

    material: str = "building"
    materials: dict[str, str] = {}
    centre: Literal["origin", "box"] = "origin"

    @model_validator(mode="before")
    @classmethod
    def _table_of_materials(cls, values: Any) -> Any:
        if isinstance(values, Mapping) and isinstance(values.get("material"), Mapping) and "materials" not in values:
            return {
                **{key: value for key, value in values.items() if key != "material"},
                "materials": values["material"],
            }
        return values
