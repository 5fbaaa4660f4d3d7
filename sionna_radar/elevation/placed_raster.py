"""An open raster file and the position of its cells in the local frame.

Pixel coordinates count columns and rows from the centre of the file's first cell; local ones are metres.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import rasterio
from jaxtyping import Float
from pyproj import CRS, Transformer
from pyproj.exceptions import ProjError

from sionna_radar.elevation.vertical import HeightSystem
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.georeference import Georeference


@dataclass(frozen=True, kw_only=True)
class PlacedRaster:
    """An open file and the position of its cells in the local frame: CRS `local` minus the origin (x, y).

    heights: unit and datum of the file's heights.
    """

    dataset: Any
    crs: CRS
    local: CRS
    origin: tuple[float, float]
    heights: HeightSystem

    @property
    def is_reprojected(self) -> bool:
        """Whether the local frame has a different projection from the file."""
        return self.local is not self.crs

    def local_of(
        self, column: Float[np.ndarray, " n"], row: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Local metres of pixel coordinates, which are integers at cell centres."""
        x, y = apply_affine(self.dataset.transform, column + 0.5, row + 0.5)
        if self.is_reprojected:
            x, y = reproject(self.crs, self.local, x, y)
        return x - self.origin[0], y - self.origin[1]

    def pixel_of(
        self, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
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
        place = self.pixel_of(np.zeros(1), np.zeros(1))
        column, row = (float(np.clip(np.nan_to_num(c[0]), 0, n)) for c, n in zip(place, limits, strict=True))
        x, y = self.local_of(np.array([column, column + 1, column]), np.array([row, row, row + 1]))
        return math.hypot(x[1] - x[0], y[1] - y[0]), math.hypot(x[2] - x[0], y[2] - y[0])


def horizontal_part(crs: CRS) -> CRS:
    """Return the horizontal part of a CRS."""
    while crs.is_compound:
        crs = crs.sub_crs_list[0]
    return crs.to_2d() if len(crs.axis_info) == 3 and not crs.is_geocentric else crs


def reproject(
    source: CRS, target: CRS, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Transform points between projections, easting or longitude first; infinite where not valid."""
    x, y = Transformer.from_crs(source, target, always_xy=True).transform(x, y)
    return np.asarray(x), np.asarray(y)


def middle_of(dataset: Any) -> tuple[float, float]:
    """Return the centre of the raster in its own CRS."""
    rows, columns = dataset.shape
    x, y = apply_affine(dataset.transform, np.array([columns / 2]), np.array([rows / 2]))
    return float(x[0]), float(y[0])


def apply_affine(
    transform: rasterio.Affine, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Apply an affine transform to points (affine 3 warns about `*`, affine 2 has no `@`)."""
    a, b, c, d, e, f = tuple(transform)[:6]
    return a * x + b * y + c, d * x + e * y + f


def in_crs_of(
    source: Any, point_m: Float[np.ndarray, "n 2"], georeference: Georeference | None, key: str
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
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
            raise ScenarioError([Problem(key, message)])
        return x, y
    if source.crs is None:
        message = "the raster has no CRS, but the terrain is georeferenced; add one with gdal_translate -a_srs"
        raise ScenarioError([Problem(key, message)])
    local = horizontal_part(CRS.from_wkt(georeference.crs_wkt))
    own = horizontal_part(CRS.from_wkt(source.crs.to_wkt()))
    if not (own.is_projected or own.is_geographic):
        message = f"the raster's CRS, {own.name!r}, is neither projected nor geographic; give the raster one that is"
        raise ScenarioError([Problem(key, message)])
    east, north = georeference.origin_m[:2]
    try:
        return reproject(local, own, x + east, y + north)
    except ProjError as error:
        message = f"the terrain's CRS, {local.name!r}, cannot be transformed to the raster's, {own.name!r} ({error})"
        raise ScenarioError([Problem(key, message)]) from error
