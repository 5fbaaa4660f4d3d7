"""The position of the local frame on the Earth."""

import math
from dataclasses import dataclass

from pyproj import CRS, Geod, Transformer


@dataclass(frozen=True, kw_only=True)
class MapCells:
    """The cells of an elevation file in map coordinates: a corner of one of them, and their size."""

    corner_m: tuple[float, float]
    size_m: tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Georeference:
    """Position of the local frame: a projected metric CRS and the offset of local coordinates.

    Local metres are map coordinates minus `origin_m` (easting, northing, height), so that float32 ray tracing keeps
    its precision.

    crs_wkt: compound, with heights in metres, if the vertical datum is known.
    cells: those of the elevation file, if it is kept in its own projection.
    """

    crs_wkt: str
    origin_m: tuple[float, float, float]
    cells: MapCells | None = None

    @property
    def vertical_name(self) -> str:
        """Name of its heights, such as "NAVD88 height"; empty if the vertical datum is unknown."""
        crs = CRS.from_wkt(self.crs_wkt)
        if crs.is_compound:
            return str(crs.sub_crs_list[1].name)
        return "Ellipsoidal height" if len(crs.axis_info) == 3 else ""

    @property
    def convergence_deg(self) -> float:
        """True azimuth of grid north at the origin: add it to a heading to refer it to true north."""
        crs = CRS.from_wkt(self.crs_wkt).to_2d()
        east, north = self.origin_m[:2]
        step_m = 100.0
        to_lonlat = Transformer.from_crs(crs, 4326, always_xy=True)
        (lon, lon_north), (lat, lat_north) = to_lonlat.transform([east, east], [north, north + step_m])
        azimuth, _, _ = Geod(ellps="WGS84").inv(lon, lat, lon_north, lat_north)
        return float(azimuth)

    def cell_centre_m(self, spacing_m: float) -> tuple[float, float]:
        """Return the centre, in local metres, of a cell of the map grid with a given spacing.

        The edges of that grid are whole multiples of the spacing in map coordinates. If the spacing is a whole
        multiple or fraction of the elevation file's cells, the grid is shifted to align with their edges.
        """
        edge = [0.0, 0.0]
        if self.cells and all(_one_holds_the_other(spacing_m, size) for size in self.cells.size_m):
            edge = [corner % size for corner, size in zip(self.cells.corner_m, self.cells.size_m, strict=True)]
        east, north = (e + spacing_m / 2 - origin for e, origin in zip(edge, self.origin_m[:2], strict=True))
        return east % spacing_m, north % spacing_m


def _one_holds_the_other(a: float, b: float) -> bool:
    """Whether one length is a whole multiple of the other."""
    ratio = max(a, b) / min(a, b)
    return math.isclose(ratio, round(ratio), rel_tol=1e-9)
