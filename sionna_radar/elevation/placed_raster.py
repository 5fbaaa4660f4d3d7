"""Georeferencing of an open raster: pixel to local coordinates, height unit and vertical datum.

Pixel coordinates count columns and rows from the centre of the file's first cell; local ones are metres.
"""

import logging
import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from pyproj import CRS, Transformer
from pyproj.crs import CompoundCRS
from pyproj.exceptions import CRSError, ProjError

from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.raster import Georeference

logger = logging.getLogger("sionna_radar")

FEET_M = {"ft": 0.3048, "foot": 0.3048, "feet": 0.3048, "us survey foot": 1200 / 3937, "ftus": 1200 / 3937}
METRES = {"m": 1.0, "metre": 1.0, "meter": 1.0, "metres": 1.0, "meters": 1.0}
# x and y, or columns and rows, of points.
Coordinates = tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]
# Heights upwards in metres, as the axis of a vertical CRS in PROJJSON.
UP_IN_METRES = {
    "subtype": "vertical",
    "axis": [{"name": "Gravity-related height", "abbreviation": "H", "direction": "up", "unit": "metre"}],
}


@dataclass(frozen=True, kw_only=True)
class HeightSystem:
    """Unit and vertical datum of a file's heights.

    unit_m: metres of one unit; negative for depths.
    vertical: the file's vertical CRS with metres upwards; None if unknown or ellipsoidal.
    ellipsoid_of: the geodetic datum of ellipsoidal heights; None for other heights.
    """

    unit_m: float
    vertical: CRS | None = None
    ellipsoid_of: str | None = None

    def compound(self, horizontal: CRS) -> CRS:
        """Return a compound CRS of a horizontal one and the heights, if their datum is known."""
        if self.ellipsoid_of and self.ellipsoid_of == _datum_of(horizontal):
            return horizontal.to_3d()
        if self.vertical is None:
            return horizontal
        return CompoundCRS(name=f"{horizontal.name} + {self.vertical.name}", components=[horizontal, self.vertical])


def height_system(unit: str | None, crs: CRS, stated_crs: str | None, stated_unit: str | None) -> HeightSystem:
    """Return the height system of an open file: as stated, otherwise from its vertical CRS, its band's unit, or metres.

    unit: of its band; None if it has none.
    crs: its CRS, including any vertical part.
    stated_crs, stated_unit: `terrain.vertical_crs` and `terrain.height_unit`; None leaves it to the file.

    Raises ScenarioError if the stated CRS is not vertical, or contradicts the unit of the file's band.
    """
    file_vertical = next((part for part in crs.sub_crs_list if part.is_vertical), None)
    vertical = _stated(stated_crs) if stated_crs else file_vertical
    is_ellipsoidal = vertical is None and len(crs.axis_info) == 3 and not crs.is_geocentric
    axis = vertical.axis_info[0] if vertical else crs.axis_info[2] if is_ellipsoidal else None
    band_unit_m = (FEET_M | METRES).get((unit or "").lower())
    if stated_unit:
        unit_m = (FEET_M | METRES)[stated_unit.lower()]
    elif axis:
        unit_m = axis.unit_conversion_factor
        if stated_crs and band_unit_m not in (None, unit_m):
            message = (
                f"{stated_crs!r} has heights in {axis.unit_name}, but the file's band is in {unit}; "
                "say which is right with terrain.height_unit"
            )
            raise ScenarioError.of("terrain.vertical_crs", message)
    else:
        unit_m = band_unit_m or _unstated(unit, crs)
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
        raise ScenarioError.of("terrain.vertical_crs", message) from error
    if not crs.is_vertical or crs.is_compound:
        message = f"{crs.name!r} is not a vertical CRS; {remedy}, and the horizontal one as terrain.crs"
        raise ScenarioError.of("terrain.vertical_crs", message)
    return crs


def cloud_height_system(
    crs: CRS, stated_crs: str | None = None, stated_unit: str | None = None, *, key: str = "terrain"
) -> HeightSystem:
    """Return the height system of a point cloud: as stated, from its vertical CRS, or in the unit of its map.

    A LAS file has one scale for x, y and z, and the exports of surveys in feet have heights in feet, whether or not a
    vertical CRS says so. Arguments as for `height_system`; key: what the cloud is for, in messages.
    """
    is_vertical = any(part.is_vertical for part in crs.sub_crs_list) or len(crs.axis_info) == 3
    unit_m = crs.axis_info[0].unit_conversion_factor if crs.is_projected or crs.is_compound else 1.0
    if stated_crs or stated_unit or is_vertical or unit_m == 1.0:
        return height_system(None, crs, stated_crs, stated_unit)
    remedy = "set terrain.height_unit if they are not" if key == "terrain" else "give the cloud a vertical CRS if not"
    logger.warning(
        "%s: no unit is stated for the cloud's heights; they are taken in %s, as its map is; %s",
        key,
        crs.axis_info[0].unit_name,
        remedy,
    )
    return HeightSystem(unit_m=unit_m)


def _unstated(unit: str | None, crs: CRS) -> float:
    if crs.is_projected and crs.axis_info[0].unit_conversion_factor != 1 and not unit:
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


@dataclass(frozen=True, kw_only=True)
class PlacedRaster:
    """An open file and the position of its cells in the local frame: CRS `local` minus the origin (x, y).

    heights: unit and datum of the file's heights. band: number of the one that holds them, from 1.
    """

    dataset: Any
    crs: CRS
    local: CRS
    origin: tuple[float, float]
    heights: HeightSystem
    band: int = 1

    @property
    def is_aligned(self) -> bool:
        """Whether the file's rows and columns run along the axes of the local frame."""
        transform = self.dataset.transform
        return not self.is_reprojected and transform.b == 0 and transform.d == 0

    @property
    def is_reprojected(self) -> bool:
        """Whether the local frame has a different projection from the file."""
        return self.local is not self.crs

    def local_of(self, column: Float[np.ndarray, " n"], row: Float[np.ndarray, " n"]) -> Coordinates:
        """Local metres of pixel coordinates, which are integers at cell centres."""
        x, y = apply_affine(self.dataset.transform, column + 0.5, row + 0.5)
        if self.is_reprojected:
            x, y = reproject(self.crs, self.local, x, y)
        return x - self.origin[0], y - self.origin[1]

    def pixel_of(self, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]) -> Coordinates:
        """Pixel coordinates (column, row) of local metres; not finite far outside the projection."""
        x, y = x + self.origin[0], y + self.origin[1]
        if self.is_reprojected:
            x, y = reproject(self.local, self.crs, x, y)
        if self.crs.is_geographic:
            # The file may have longitudes from 0 to 360, or span the date line.
            turn = 2 * math.pi / self.crs.axis_info[0].unit_conversion_factor
            middle = middle_of(self.dataset)[0]
            x = middle + (x - middle + turn / 2) % turn - turn / 2
        column, row = apply_affine(~self.dataset.transform, x, y)
        return column - 0.5, row - 0.5

    @property
    def steps_m(self) -> tuple[float, float]:
        """Distance between neighbouring columns and between neighbouring rows, next to the local origin."""
        limits = [n - 1 for n in reversed(self.dataset.shape)]
        pixel = self.pixel_of(np.zeros(1), np.zeros(1))
        column, row = (float(np.clip(np.nan_to_num(c[0]), 0, n)) for c, n in zip(pixel, limits, strict=True))
        x, y = self.local_of(np.array([column, column + 1, column]), np.array([row, row, row + 1]))
        return math.hypot(x[1] - x[0], y[1] - y[0]), math.hypot(x[2] - x[0], y[2] - y[0])


def vertical_datum(crs: CRS) -> str | None:
    """Return the vertical datum of heights; None where a CRS does not name it."""
    vertical = next((part for part in crs.sub_crs_list if part.is_vertical), None)
    if vertical is not None:
        return vertical.datum.name if vertical.datum else vertical.name
    return "the ellipsoid" if len(crs.axis_info) == 3 and not crs.is_geocentric else None


def horizontal_crs(crs: CRS) -> CRS:
    """Return the horizontal part of a CRS."""
    while crs.is_compound:
        crs = crs.sub_crs_list[0]
    return crs.to_2d() if len(crs.axis_info) == 3 and not crs.is_geocentric else crs


def reproject(source: CRS, target: CRS, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]) -> Coordinates:
    """Transform points between projections, easting or longitude first; infinite where not valid."""
    # As lists: pyproj takes an array of one for a point, of which NumPy before 2.4 warns.
    points = (x.tolist(), y.tolist()) if x.size == 1 else (x, y)
    x, y = Transformer.from_crs(source, target, always_xy=True).transform(*points)
    return np.asarray(x), np.asarray(y)


def middle_of(dataset: Any) -> tuple[float, float]:
    """Return the centre of the raster in its own CRS."""
    rows, columns = dataset.shape
    x, y = apply_affine(dataset.transform, np.array([columns / 2]), np.array([rows / 2]))
    return float(x[0]), float(y[0])


def apply_affine(transform: Iterable[float], x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]) -> Coordinates:
    """Apply an affine transform to points (affine 3 warns about `*`, affine 2 has no `@`)."""
    a, b, c, d, e, f = tuple(transform)[:6]
    with np.errstate(over="ignore", invalid="ignore"):  # of an absurd one: it overlaps nothing
        return a * x + b * y + c, d * x + e * y + f


def in_crs_of(
    source: Any, point_m: Float[np.ndarray, "n 2"], georeference: Georeference | None, key: str
) -> Coordinates:
    """Return local points in the coordinates of an open raster.

    Raises ScenarioError, for the given key, if only one of raster and terrain is georeferenced.
    """
    x, y = point_m.T
    if georeference is None:
        if source.crs is not None:
            message = (
                f"the raster is in {source.crs.to_string()}, but the terrain is not georeferenced; remove the "
                "raster's CRS, so that its coordinates are local metres, or use a georeferenced terrain"
            )
            raise ScenarioError.of(key, message)
        return x, y
    if source.crs is None:
        message = "the raster has no CRS, but the terrain is georeferenced; add one with gdal_translate -a_srs"
        raise ScenarioError.of(key, message)
    local = horizontal_crs(CRS.from_wkt(georeference.crs_wkt))
    raster_crs = horizontal_crs(CRS.from_wkt(source.crs.to_wkt()))
    if not (raster_crs.is_projected or raster_crs.is_geographic):
        message = (
            f"the raster's CRS, {raster_crs.name!r}, is neither projected nor geographic; give the raster one that is"
        )
        raise ScenarioError.of(key, message)
    east, north = georeference.origin_m[:2]
    try:
        return reproject(local, raster_crs, x + east, y + north)
    except ProjError as error:
        message = (
            f"the terrain's CRS, {local.name!r}, cannot be transformed to the raster's, {raster_crs.name!r} ({error})"
        )
        raise ScenarioError.of(key, message) from error
