"""The place of a local frame on the map, known before anything is read into it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from pyproj import CRS
from pyproj.aoi import AreaOfInterest
from pyproj.database import query_utm_crs_info

from sionna_radar.elevation.placed_raster import horizontal_part, reproject
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.georeference import Georeference


@dataclass(frozen=True, kw_only=True)
class MapFrame:
    """A local frame on the map: a projected CRS in metres, and the easting and northing of the local origin."""

    crs: CRS
    origin_m: tuple[float, float]

    def local_of(
        self, crs: CRS, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
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

    Raises ScenarioError, for `terrain.centre_lonlat_deg`, if it is no place on Earth.
    """
    check_lonlat(lon_deg, lat_deg)
    crs = metric_crs(lon_deg, lat_deg)
    x, y = reproject(CRS(4326), crs, np.array([lon_deg]), np.array([lat_deg]))
    return MapFrame(crs=crs, origin_m=(float(x[0]), float(y[0])))


def frame_of(place: Georeference | None) -> MapFrame | None:
    """Return the frame of a georeference; None for ground on no map."""
    if place is None:
        return None
    return MapFrame(crs=horizontal_part(CRS.from_wkt(place.crs_wkt)), origin_m=place.origin_m[:2])


def check_lonlat(lon_deg: float, lat_deg: float) -> None:
    """Raise ScenarioError, for `terrain.centre_lonlat_deg`, if there is no such place."""
    if not (-180 <= lon_deg <= 360 and -90 <= lat_deg <= 90):
        message = f"({lon_deg:g}, {lat_deg:g}) is not a longitude and latitude in degrees; give them in this order"
        raise ScenarioError([Problem("terrain.centre_lonlat_deg", message)])


def metric_crs(lon_deg: float, lat_deg: float) -> CRS:
    """Return the UTM zone of a place; near a pole, where there is none, a local transverse Mercator."""
    lon = (lon_deg + 180) % 360 - 180
    place = AreaOfInterest(lon, lat_deg, lon, lat_deg)
    zones = query_utm_crs_info(datum_name="WGS 84", area_of_interest=place) if -80 <= lat_deg <= 84 else []
    if zones:
        return CRS.from_authority(zones[0].auth_name, zones[0].code)
    return CRS.from_dict({"proj": "tmerc", "lat_0": lat_deg, "lon_0": lon, "datum": "WGS84", "units": "m"})
