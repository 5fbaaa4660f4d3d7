"""Unit and vertical datum of the heights of an elevation file."""

import logging
import re
from dataclasses import dataclass
from typing import Any

from pyproj import CRS
from pyproj.crs import CompoundCRS
from pyproj.exceptions import CRSError

from sionna_radar.foundation.errors import Problem, ScenarioError

logger = logging.getLogger("sionna_radar")

FEET_M = {"ft": 0.3048, "foot": 0.3048, "feet": 0.3048, "us survey foot": 1200 / 3937, "ftus": 1200 / 3937}
METRES = {"m": 1.0, "metre": 1.0, "meter": 1.0, "metres": 1.0, "meters": 1.0}
# Heights upwards in metres, as the axis of a vertical CRS in PROJJSON.
UP_IN_METRES = {
    "subtype": "vertical",
    "axis": [{"name": "Gravity-related height", "abbreviation": "H", "direction": "up", "unit": "metre"}],
}


@dataclass(frozen=True, kw_only=True)
class HeightSystem:
    """How heights of a file become metres above a datum.

    unit_m: metres of one unit; negative for depths.
    vertical: the file's vertical CRS with metres upwards; None if unknown or ellipsoidal.
    ellipsoid_of: the geodetic datum of ellipsoidal heights; None for other heights.
    """

    unit_m: float
    vertical: CRS | None = None
    ellipsoid_of: str | None = None

    def compound(self, horizontal: CRS) -> CRS:
        """Return a compound CRS of a horizontal one and the heights, as far as their datum is known."""
        if self.ellipsoid_of and self.ellipsoid_of == _datum_of(horizontal):
            return horizontal.to_3d()
        if self.vertical is None:
            return horizontal
        name = f"{horizontal.name} + {self.vertical.name}"
        return CompoundCRS(name=name, components=[horizontal, self.vertical])


def height_system(dataset: Any, crs: CRS, stated_crs: str | None, stated_unit: str | None) -> HeightSystem:
    """Return the height system of an open file: as stated, otherwise from its vertical CRS, its band's unit, or metres.

    Parameters
    ----------
    dataset:
        The open file (rasterio).
    crs:
        Its CRS, including any vertical part.
    stated_crs, stated_unit:
        `terrain.vertical_crs` and `terrain.height_unit`; None leaves it to the file.

    Raises
    ------
    ScenarioError
        The stated CRS is not vertical, or contradicts the unit of the file's band.

    """
    own = next((part for part in crs.sub_crs_list if part.is_vertical), None)
    vertical = _stated(stated_crs) if stated_crs else own
    is_ellipsoidal = vertical is None and len(crs.axis_info) == 3 and not crs.is_geocentric
    axis = vertical.axis_info[0] if vertical else crs.axis_info[2] if is_ellipsoidal else None
    band_unit_m = (FEET_M | METRES).get((dataset.units[0] or "").lower())
    if stated_unit:
        unit_m = (FEET_M | METRES)[stated_unit.lower()]
    elif axis:
        unit_m = axis.unit_conversion_factor
        if stated_crs and band_unit_m not in (None, unit_m):
            message = (
                f"{stated_crs!r} has heights in {axis.unit_name}, but the file's band is in {dataset.units[0]}; "
                "say which is right with terrain.height_unit"
            )
            raise ScenarioError([Problem("terrain.vertical_crs", message)])
    else:
        unit_m = band_unit_m or _unstated(dataset, crs)
    sign = -1 if axis and axis.direction == "down" else 1
    upright = _in_metres_up(vertical) if vertical else None
    return HeightSystem(unit_m=sign * unit_m, vertical=upright, ellipsoid_of=_datum_of(crs) if is_ellipsoidal else None)


def _datum_of(crs: CRS) -> str | None:
    return crs.geodetic_crs.datum.name if crs.geodetic_crs and crs.geodetic_crs.datum else None


def _stated(name: str) -> CRS:
    remedy = "give one such as 'EPSG:5703' (NAVD88) or 'EPSG:5773' (EGM96)"
    try:
        crs = CRS.from_user_input(name)
    except CRSError as error:
        message = f"{name!r} is not a coordinate reference system; {remedy}"
        raise ScenarioError([Problem("terrain.vertical_crs", message)]) from error
    if not crs.is_vertical or crs.is_compound:
        message = f"{crs.name!r} is not a vertical CRS; {remedy}, and the horizontal one as terrain.crs"
        raise ScenarioError([Problem("terrain.vertical_crs", message)])
    return crs


def _unstated(dataset: Any, crs: CRS) -> float:
    if crs.is_projected and crs.axis_info[0].unit_conversion_factor != 1 and not dataset.units[0]:
        logger.warning(
            "terrain: the map is in %s but no unit is given for heights; they are taken as metres. "
            "Set terrain.height_unit",
            crs.axis_info[0].unit_name,
        )
    return 1.0


def _in_metres_up(vertical: CRS) -> CRS:
    """Return a vertical CRS of the same datum with heights in metres upwards, as in all results."""
    axis = vertical.axis_info[0]
    if axis.unit_conversion_factor == 1 and axis.direction == "up":
        return vertical
    described = vertical.to_json_dict()
    described.pop("id", None)
    described["coordinate_system"] = UP_IN_METRES
    described["name"] = re.sub(r" \(.*\)$", "", described["name"]).replace("depth", "height")
    changed = CRS.from_json_dict(described)
    authority = changed.to_authority(min_confidence=70)
    return CRS.from_authority(*authority) if authority else changed
