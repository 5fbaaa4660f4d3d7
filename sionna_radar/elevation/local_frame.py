"""Choice of the local map frame of a survey: projection and origin, from a file or a scenario.

A file is kept in its own projection if that is true to scale (metres, unit scale, north up), and transformed
into the UTM zone of its centre otherwise.

The position on the map is known before any data are read.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from jaxtyping import Float
from pyproj import CRS, Geod
from pyproj.database import CRSInfo, query_utm_crs_info
from pyproj.exceptions import ProjError

from sionna_radar.elevation.placed_raster import (
    Coordinates,
    PlacedRaster,
    height_system,
    horizontal_crs,
    middle_of,
    reproject,
)
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.input_file import shown
from sionna_radar.foundation.raster import Georeference


@dataclass(frozen=True, kw_only=True)
class MapFrame:
    """A local frame on the map: a projected CRS in metres, and the easting and northing of the local origin."""

    crs: CRS
    origin_m: tuple[float, float]

    def local_of(self, crs: CRS, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]) -> Coordinates:
        """Return local metres of positions in another CRS, easting or longitude first; not finite where invalid there.

        Raises pyproj.exceptions.ProjError if one CRS cannot be transformed to the other.
        """
        east, north = reproject(crs, self.crs, x, y)
        return east - self.origin_m[0], north - self.origin_m[1]

    def georeference(self) -> Georeference:
        """Return the georeference of a frame whose heights have no datum."""
        return Georeference(crs_wkt=self.crs.to_wkt(), origin_m=(*self.origin_m, 0.0))


def frame_at(lon_deg: float, lat_deg: float) -> MapFrame:
    """Return the frame about a place (WGS 84) in its UTM zone.

    Raises ScenarioError, for `terrain.centre_lonlat_deg`, if it is not a valid position.
    """
    check_lonlat(lon_deg, lat_deg)
    crs = metric_crs(lon_deg, lat_deg)
    x, y = reproject(CRS(4326), crs, np.array([lon_deg]), np.array([lat_deg]))
    return MapFrame(crs=crs, origin_m=(float(x[0]), float(y[0])))


def frame_of(place: Georeference | None) -> MapFrame | None:
    """Return the frame of a georeference; None without one."""
    if place is None:
        return None
    return MapFrame(crs=horizontal_crs(CRS.from_wkt(place.crs_wkt)), origin_m=place.origin_m[:2])


def check_lonlat(lon_deg: float, lat_deg: float) -> None:
    """Raise ScenarioError, for `terrain.centre_lonlat_deg`, if it is not a valid position."""
    if not (-180 <= lon_deg <= 360 and -90 <= lat_deg <= 90):
        message = f"({lon_deg:g}, {lat_deg:g}) is not a longitude and latitude in degrees; give them in this order"
        raise ScenarioError.of("terrain.centre_lonlat_deg", message)


def metric_crs(lon_deg: float, lat_deg: float) -> CRS:
    """Return the UTM zone of a place; near a pole a local transverse Mercator."""
    lon = (lon_deg + 180) % 360 - 180
    for zone in _utm_zones() if -80 <= lat_deg <= 84 else ():
        area = zone.area_of_use
        if area is not None and area.west <= lon <= area.east and area.south <= lat_deg <= area.north:
            return CRS.from_authority(zone.auth_name, zone.code)
    return CRS.from_dict({"proj": "tmerc", "lat_0": lat_deg, "lon_0": lon, "datum": "WGS84", "units": "m"})


@cache
def _utm_zones() -> list[CRSInfo]:
    """Return all UTM zones: a query of PROJ's database takes as long for one place as for all."""
    return query_utm_crs_info(datum_name="WGS 84")


# Tolerance of scale and north for a projection kept as the local frame.
MAX_SCALE_ERROR = 0.01
MAX_CONVERGENCE_DEG = 10.0


@dataclass(frozen=True, kw_only=True)
class StatedFrame:
    """Frame settings of a scenario for an elevation file; None leaves them to the file.

    crs, vertical_crs: its horizontal (or compound) and its vertical coordinate reference system.
    height_unit: unit of its heights.
    centre_lonlat_deg: local origin (WGS 84); None takes the centre of the file.
    band: number of the one with heights, from 1; None takes the first.
    """

    crs: str | None = None
    vertical_crs: str | None = None
    height_unit: str | None = None
    centre_lonlat_deg: tuple[float, float] | None = None
    band: int | None = None


def data_bands(dataset: Any) -> Iterator[int]:
    """Yield the numbers of an open raster's bands, from 1, without those of opacity."""
    for number, meaning in enumerate(dataset.colorinterp, start=1):
        if meaning.name != "alpha":
            yield number


def _band_of(dataset: Any, stated: int | None) -> int:
    """Return the band with heights; ScenarioError if there is none of that number, or it holds no numbers."""
    band = next(data_bands(dataset), 1) if stated is None else stated
    if band > dataset.count:
        raise ScenarioError.of("terrain.band", f"{band} is not in the file, which has {dataset.count}; lower it")
    if np.dtype(dataset.dtypes[band - 1]).kind not in "iuf":
        message = f"{band} holds {dataset.dtypes[band - 1]} values, not heights; give another"
        raise ScenarioError.of("terrain.band", message)
    return band


def place_file(dataset: Any, stated: StatedFrame) -> PlacedRaster:
    """Return an open file (rasterio) with its local frame: own projection or UTM zone, about the centre.

    Raises ScenarioError if there is no such CRS, it is neither projected nor geographic, or the centre is not valid in
        it.
    """
    file_crs = _crs_of(dataset, stated.crs)
    crs = horizontal_crs_of(file_crs)
    frame = frame_about(crs, middle_of(dataset), stated.centre_lonlat_deg, "raster's centre")
    band = _band_of(dataset, stated.band)
    heights = height_system(dataset.units[band - 1], file_crs, stated.vertical_crs, stated.height_unit)
    return PlacedRaster(dataset=dataset, crs=crs, local=frame.crs, origin=frame.origin_m, heights=heights, band=band)


def frame_about(crs: CRS, middle: tuple[float, float], wanted: tuple[float, float] | None, what: str) -> MapFrame:
    """Return the local frame of a file: its own projection, if that is true to scale, or else the UTM zone.

    crs, middle: of the file; the middle in its own coordinates.
    wanted: `terrain.centre_lonlat_deg`, the local origin; None for the middle.
    what: the middle in words, for messages.

    Raises ScenarioError if the CRS does not contain the middle, or there is no such origin.
    """
    lon, lat = _centre_lonlat(crs, middle, wanted, what)
    local = crs if is_true_to_the_ground(crs, lon, lat) else metric_crs(lon, lat)
    if wanted is None and local is crs:
        return MapFrame(crs=local, origin_m=middle)
    x, y = (float(c[0]) for c in reproject(CRS(4326), local, np.array([lon]), np.array([lat])))
    return MapFrame(crs=local, origin_m=(x, y))


def stated_crs(name: str, key: str = "terrain.crs") -> CRS:
    """Return the CRS that a key states, by default `terrain.crs`; ScenarioError if invalid."""
    try:
        return CRS.from_user_input(name)
    except ProjError as error:
        message = f"{shown(name)} is not a coordinate reference system; give one such as 'EPSG:32631'"
        raise ScenarioError.of(key, message) from error


def horizontal_crs_of(whole: CRS, key: str = "terrain.crs") -> CRS:
    """Return the horizontal part of a CRS; ScenarioError if neither projected nor geographic."""
    crs = horizontal_crs(whole)
    if not (crs.is_projected or crs.is_geographic):
        message = f"{crs.name!r} is neither projected nor geographic; give one that is, such as 'EPSG:32631'"
        raise ScenarioError.of(key, message)
    return crs


def _crs_of(dataset: Any, name: str | None) -> CRS:
    """Return the scenario's CRS, otherwise the file's."""
    if name is not None:
        return stated_crs(name)
    if dataset.crs is None or not dataset.crs.to_wkt():
        message = "missing, and the file has no CRS; give the CRS of the file, such as 'EPSG:32631'"
        raise ScenarioError.of("terrain.crs", message)
    return CRS.from_wkt(dataset.crs.to_wkt())


def _centre_lonlat(
    crs: CRS, middle: tuple[float, float], requested: tuple[float, float] | None, label: str
) -> tuple[float, float]:
    if requested is not None:
        check_lonlat(*requested)
        return requested
    x, y = middle
    lons, lats = reproject(crs, CRS(4326), np.array([x]), np.array([y]))
    lon, lat = float(lons[0]), float(lats[0])
    latitude_too_far = crs.is_geographic and abs(y) * crs.axis_info[0].unit_conversion_factor > math.pi / 2
    if not (math.isfinite(lon) and math.isfinite(lat)) or latitude_too_far:
        message = f"{crs.name!r} does not contain the {label} ({x:g}, {y:g}); give the CRS of the file"
        raise ScenarioError.of("terrain.crs", message)
    return lon, lat


def is_true_to_the_ground(crs: CRS, lon: float, lat: float) -> bool:
    """Whether metres of a projection are true metres at a place (WGS 84, degrees), and north is up."""
    if not (crs.is_projected and all(axis.unit_conversion_factor == 1 for axis in crs.axis_info)):
        return False
    step = 100.0
    x, y = reproject(CRS(4326), crs, np.array([lon]), np.array([lat]))
    lons, lats = reproject(crs, CRS(4326), x + step * np.array([0, 1, 0]), y + step * np.array([0, 0, 1]))
    if not np.isfinite([lons, lats]).all():
        return False
    azimuth, _, distance = Geod(ellps="WGS84").inv(lons[[0, 0]], lats[[0, 0]], lons[1:], lats[1:])
    scale_error = np.abs(np.asarray(distance) / step - 1).max()
    return bool(scale_error <= MAX_SCALE_ERROR and abs(azimuth[1]) <= MAX_CONVERGENCE_DEG)
