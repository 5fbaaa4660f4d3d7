"""Elevation rasters in the local frame, and the position of that frame on the Earth."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from pyproj import CRS, Geod, Transformer
from scipy.ndimage import map_coordinates

from sionna_radar.foundation.errors import InputFileError, OutputError
from sionna_radar.foundation.input_file import shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from xarray import DataArray

Quantity = Literal[
    "height", "height difference", "height error", "standard deviation of the height", "probability", "mask"
]
COLOURS: dict[Quantity, str] = {
    "height": "terrain",
    "height difference": "YlGn",
    "height error": "RdBu_r",
    "standard deviation of the height": "viridis",
    "probability": "magma",
    "mask": "Greys",
}
# Heights at horizontal positions.
Heights = Callable[[Float[np.ndarray, "n 2"]], Float[np.ndarray, " n"]]
# Cells of the largest raster that is read as a whole, 800 MB in memory.
MAX_READ_CELLS = 100_000_000
REMEDY = "convert it with gdalwarp -t_srs EPSG:<projected CRS in metres> -tr <spacing> <spacing>"


def spans(extent: tuple[float, float, float, float]) -> str:
    """Return west, south, east and north as words, in metres."""
    return "x = {0:.0f} to {2:.0f} m, y = {1:.0f} to {3:.0f} m".format(*extent)


def box_around(place_m: Float[np.ndarray, "n 2"], margin_m: float = 0.0) -> tuple[float, float, float, float]:
    """Return west, south, east and north of places, m, with a margin to each side."""
    (west, south), (east, north) = place_m.min(axis=0) - margin_m, place_m.max(axis=0) + margin_m
    return float(west), float(south), float(east), float(north)


@dataclass(frozen=True, kw_only=True)
class Grid:
    """Square cells in the horizontal plane, by their centres; rows run from south to north.

    georeference: position of the local frame on the map, which does not affect the cells; None if unknown.
    """

    west_m: float
    south_m: float
    spacing_m: float
    columns: int
    rows: int
    georeference: "Georeference | None" = field(default=None, compare=False, repr=False)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.rows, self.columns

    @property
    def x_m(self) -> Float[np.ndarray, " column"]:
        """Eastings of the cell centres."""
        return self.west_m + self.spacing_m * np.arange(self.columns)

    @property
    def y_m(self) -> Float[np.ndarray, " row"]:
        """Northings of the cell centres."""
        return self.south_m + self.spacing_m * np.arange(self.rows)

    @property
    def centres_m(self) -> Float[np.ndarray, "cell 2"]:
        """Cell centres, row by row."""
        x, y = np.meshgrid(self.x_m, self.y_m)
        return np.column_stack([x.ravel(), y.ravel()])

    @property
    def extent_m(self) -> tuple[float, float, float, float]:
        """Outer edges (west, east, south, north)."""
        half = self.spacing_m / 2
        return (
            self.west_m - half,
            self.west_m + self.spacing_m * (self.columns - 1) + half,
            self.south_m - half,
            self.south_m + self.spacing_m * (self.rows - 1) + half,
        )

    def cell_of(
        self, place_m: Float[np.ndarray, "n k"]
    ) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
        """Return row and column of the cell nearest to each position (east, north, ...), and whether it is inside."""
        column = np.round((place_m[:, 0] - self.west_m) / self.spacing_m).astype(np.int64)
        row = np.round((place_m[:, 1] - self.south_m) / self.spacing_m).astype(np.int64)
        inside = (row >= 0) & (row < self.rows) & (column >= 0) & (column < self.columns)
        return np.clip(row, 0, self.rows - 1), np.clip(column, 0, self.columns - 1), inside

    @property
    def transform(self) -> tuple[float, ...]:
        """Return the six numbers from columns and rows, counted from the north-west corner, to map coordinates."""
        east_m, north_m = self.georeference.origin_m[:2] if self.georeference else (0.0, 0.0)
        west_edge, _, _, north_edge = self.extent_m
        # To a micrometre: sums of local and map coordinates have round-off that other rasters of the same cells lack.
        # Not rasterio's from_origin: its multiplication causes a warning with affine 3.
        return self.spacing_m, 0.0, round(west_edge + east_m, 6), 0.0, -self.spacing_m, round(north_edge + north_m, 6)

    def cut(self, rows: slice, columns: slice) -> "Grid":
        """Return a part of the grid; both slices need a start and a stop within it."""
        return Grid(
            west_m=float(self.x_m[columns.start]),
            south_m=float(self.y_m[rows.start]),
            spacing_m=self.spacing_m,
            columns=columns.stop - columns.start,
            rows=rows.stop - rows.start,
            georeference=self.georeference,
        )

    @staticmethod
    def covering(
        west: float,
        south: float,
        east: float,
        north: float,
        spacing_m: float,
        centre_m: tuple[float, float] = (0.0, 0.0),
    ) -> "Grid":
        """Return the grid of square cells that covers a rectangle, with one cell centred at `centre_m`."""
        first_column, columns = _cells_over(west - centre_m[0], east - centre_m[0], spacing_m)
        first_row, rows = _cells_over(south - centre_m[1], north - centre_m[1], spacing_m)
        return Grid(
            west_m=centre_m[0] + first_column * spacing_m,
            south_m=centre_m[1] + first_row * spacing_m,
            spacing_m=spacing_m,
            columns=columns,
            rows=rows,
        )


def _cells_over(low_m: float, high_m: float, spacing_m: float) -> tuple[int, int]:
    """Return the index of the first cell, relative to the one at 0, and the number of cells from low to high."""
    first = int(np.floor(low_m / spacing_m))
    return first, int(np.ceil(high_m / spacing_m)) - first + 1


@dataclass(frozen=True, kw_only=True)
class Raster:
    """Heights on a grid, or their errors or standard deviations.

    grid: west and south are the centres of the first cells, in metres; rows go north.
    height_m: heights in metres, shape (row, column); an empty cell is NaN.
    quantity: what the values are; heights count from the local origin.

    Examples
    --------
    >>> import numpy as np
    >>> raster = Raster.from_array(np.array([[1.0, 2.0], [3.0, 4.0]]), spacing_m=2.0, west_m=0.0, south_m=0.0)
    >>> float(raster.at(np.array([[1.0, 1.0]]))[0])
    2.5
    """

    grid: Grid
    height_m: Float[np.ndarray, "row column"]
    quantity: Quantity = "height"

    @staticmethod
    def from_array(
        height_m: Shaped[np.ndarray, "row column"],
        spacing_m: float,
        *,
        west_m: float | None = None,
        south_m: float | None = None,
    ) -> "Raster":
        """Return a raster of heights in metres, rows from south to north; an empty cell is NaN.

        west_m, south_m: centre of the first cell; without them the raster is centred on the local origin. An image with
        north up is turned first: `np.flipud(image)`.

        Raises ValueError for anything but a table of real numbers, and for a spacing that is not positive.
        """
        table = np.asarray(height_m)
        if table.ndim != 2 or table.size == 0 or table.dtype.kind not in "fiu":
            raise ValueError(
                f"height_m = {table.dtype} of shape {table.shape}; give a table of heights (row, column) in metres"
            )
        if not 0 < spacing_m < math.inf:
            message = f"spacing_m = {spacing_m:g} must be greater than 0; give the distance of cell centres in metres"
            raise ValueError(message)
        rows, columns = table.shape
        grid = Grid(
            west_m=-spacing_m * (columns - 1) / 2 if west_m is None else west_m,
            south_m=-spacing_m * (rows - 1) / 2 if south_m is None else south_m,
            spacing_m=float(spacing_m),
            columns=columns,
            rows=rows,
        )
        return Raster(grid=grid, height_m=table if table.dtype.kind == "f" else table.astype(np.float64))

    @staticmethod
    def read(path: str | Path) -> "Raster":
        """Return the heights of a GeoTIFF or another raster file, in its own map coordinates.

        Cells are square, with north up, in metres; a file without a CRS is taken to be in metres. Rasters that a survey
        wrote (`dem.tif`, `error.tif`, ...) are such files.

        Raises InputFileError for a file that cannot be read, or has other cells or units.
        """
        from sionna_radar.foundation.raster_file import open_raster, read_square_cells

        path = Path(path)
        named = f"raster = {shown(path)}"
        with open_raster(path, "raster") as file:
            if file.crs and (file.crs.is_geographic or not math.isclose(file.crs.linear_units_factor[1], 1.0)):
                raise InputFileError(f"{named} counts in {file.crs.units_factor[0]}, not in metres; {REMEDY}")
            cells = read_square_cells(file, named, REMEDY, MAX_READ_CELLS)
        return Raster.from_array(cells.height_m, cells.spacing_m, west_m=cells.west_m, south_m=cells.south_m)

    @property
    def filled(self) -> Bool[np.ndarray, "row column"]:
        """Cells that have a height."""
        return np.isfinite(self.height_m)

    def within(self, cells: Bool[np.ndarray, "row column"]) -> "Raster":
        """Return the raster with all other cells emptied."""
        return replace(self, height_m=np.where(cells, self.height_m, np.nan))

    def at(self, point_m: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """Return bilinear heights; NaN outside the cell centres or next to an empty cell."""
        grid = self.grid
        column = (point_m[:, 0] - grid.west_m) / grid.spacing_m
        row = (point_m[:, 1] - grid.south_m) / grid.spacing_m
        return map_coordinates(self.height_m, [row, column], order=1, cval=np.nan)

    @property
    def map_height_m(self) -> Float[np.ndarray, "row column"]:
        """The values, heights over the datum of the map where the place of the local frame is known."""
        place = self.grid.georeference
        return self.height_m + (place.origin_m[2] if place and self.quantity == "height" else 0.0)

    @property
    def unit(self) -> str:
        """Unit of the values."""
        return "1" if self.quantity in ("probability", "mask") else "m"

    def to_geotiff(
        self, path: str | Path, description: str | None = None, metadata: Mapping[str, str] | None = None
    ) -> None:
        """Write a cloud-optimised GeoTIFF in map coordinates, or in local ones where the place is not known.

        Rows go from north to south, empty cells are NaN. The band has a description, without one the quantity, and the
        file what metadata it is given. A file that is there already is not overwritten.

        Raises OutputError for a file that exists, or a folder that cannot be written.
        """
        from sionna_radar.foundation.raster_file import write_pixels

        path, place, metadata = Path(path), self.grid.georeference, metadata or {}
        if path.exists():
            raise OutputError(f"{shown(path)} exists already; name another file, or remove it")
        crs_wkt, pixels = place.crs_wkt if place else None, self.map_height_m[::-1].astype(np.float32)
        try:
            write_pixels(path, pixels, self.grid.transform, crs_wkt, description or self.quantity, self.unit, metadata)
        except OSError as error:
            message = f"{shown(path)} cannot be written ({error}); name another folder, or free some space"
            raise OutputError(message) from error

    def to_xarray(self) -> "DataArray":
        """Return the values with their coordinates, as an `xarray.DataArray` of the dimensions y and x.

        The coordinates are cell centres, on the map where the place of the local frame is known (then with a
        `spatial_ref` of CF), otherwise local; y increases with the rows. Needs the extra `arrays`.
        """
        from xarray import DataArray

        place, grid = self.grid.georeference, self.grid
        east_m, north_m = place.origin_m[:2] if place else (0.0, 0.0)
        array = DataArray(
            self.map_height_m,
            dims=("y", "x"),
            coords={"y": grid.y_m + north_m, "x": grid.x_m + east_m},
            name=self.quantity.replace(" ", "_"),
            attrs={"long_name": self.quantity, "units": self.unit},
        )
        for axis, way in (("x", "east"), ("y", "north")):
            array[axis].attrs = {"long_name": f"{way}ing" if place else f"{way} of the local origin", "units": "m"}
        if place:
            array = array.assign_coords(spatial_ref=((), 0, CRS.from_wkt(place.crs_wkt).to_cf()))
        return array

    def plot(self, axes: "Axes | None" = None) -> "Axes":
        """Draw the raster with a colour bar, into the current figure without axes, and return the axes."""
        import matplotlib.pyplot as plt

        axes = axes or plt.gca()
        limit = float(np.nanmax(np.abs(self.height_m), initial=0.0)) if self.quantity == "height error" else None
        image = axes.imshow(
            np.ma.masked_invalid(self.height_m),
            origin="lower",
            extent=self.grid.extent_m,
            cmap=COLOURS[self.quantity],
            vmin=None if limit is None else -limit,
            vmax=limit,
        )
        axes.set(xlabel="East (m)", ylabel="North (m)", title=self.quantity.capitalize())
        axes.figure.colorbar(image, ax=axes, label=self.unit)
        return axes


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
        if self.cells and all(_is_multiple(spacing_m, size) for size in self.cells.size_m):
            edge = [corner % size for corner, size in zip(self.cells.corner_m, self.cells.size_m, strict=True)]
        east, north = (e + spacing_m / 2 - origin for e, origin in zip(edge, self.origin_m[:2], strict=True))
        return east % spacing_m, north % spacing_m


def _is_multiple(a: float, b: float) -> bool:
    """Whether one length is a whole multiple of the other."""
    ratio = max(a, b) / min(a, b)
    return math.isclose(ratio, round(ratio), rel_tol=1e-9)
