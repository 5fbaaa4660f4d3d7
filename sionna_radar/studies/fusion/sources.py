"""Reading the sources of a fusion: folders of results, recordings, point clouds and elevation rasters.

The DEM of a survey is taken rather than its points: it was made from whole echoes with the beam known, while a table of
points holds neither the footprints nor what the beam does to a range on a slope. Clouds of other sensors are mapped by
the method `smooth`, as the points of a lidar are.
"""

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from pyproj import CRS
from pyproj.exceptions import ProjError
from rasterio.transform import Affine

from sionna_radar.accuracy.reference import ReferenceSurface
from sionna_radar.elevation.file_heights import MAX_HEIGHT_M, UNDECLARED_NODATA
from sionna_radar.elevation.local_frame import MapFrame
from sionna_radar.elevation.placed_raster import (
    apply_affine,
    cloud_height_system,
    height_system,
    horizontal_crs,
    reproject,
    vertical_datum,
)
from sionna_radar.elevation.point_cloud import GROUND_CLASS, Piece, open_cloud
from sionna_radar.foundation.errors import InputFileError, RadarError, ScenarioError
from sionna_radar.foundation.input_file import is_folder, parse_toml, read_text, shown
from sionna_radar.foundation.raster import MAX_READ_CELLS, Georeference, Grid, Raster
from sionna_radar.foundation.raster_file import open_raster, require_cells
from sionna_radar.mapping.mapper import MAX_DEM_CELLS, MICRORELIEF_M, MapInputs
from sionna_radar.mapping.points import Points
from sionna_radar.mapping.refined.refinement import Smooth
from sionna_radar.mapping.tiles import MIN_PULSES
from sionna_radar.scenario import parse_scenario
from sionna_radar.survey.reprocessing import process

logger = logging.getLogger("sionna_radar")

KEY = "source"
MAX_SOURCES = 12
REMEDY = "give a folder of `run` or `process`, a recording (.nc, .toml), a LAS or LAZ cloud, or an elevation raster"
RECORDINGS, CLOUDS = (".nc", ".toml"), (".las", ".laz")
# Extra dimensions of clouds that hold the standard deviation of each point, m; the second is of this program.
SIGMA_DIMENSIONS = ("sigma_m", "range_sigma_m")
# Filled cells of the largest cloud; its mapping takes about a minute for 20,000.
MAX_CLOUD_CELLS = 200_000
# Gaps of a cloud narrower than this many cells are closed.
GAP_CELLS = 3.0
# Height above the ground from which a cloud counts as seen, m: straight from above.
ABOVE_M = 1000.0

Kind = Literal["survey", "recording", "cloud", "raster"]
Mapped = Callable[[Grid, float], tuple[ReferenceSurface, Float[np.ndarray, "row column"]]]


@dataclass(frozen=True, kw_only=True)
class Source:
    """Heights of one sensor, over their vertical datum.

    crs: with the vertical part where it is known; None for local metres.
    extent_m: west, south, east and north in that CRS.
    spacing_m: of a raster; None for a cloud.
    surface, sigma_m: heights and their standard deviations, rows from north to south; None for a cloud that is not
        mapped yet. navigation_m: what errors of navigation add, common to neighbouring cells; None if not stated.
    mapped: maps a cloud on a grid, given the microrelief.
    microrelief_m: of the ground; see `Mapper`.
    """

    name: str
    kind: Kind
    crs: CRS | None
    extent_m: tuple[float, float, float, float]
    spacing_m: float | None = None
    surface: ReferenceSurface | None = None
    sigma_m: Float[np.ndarray, "row column"] | None = None
    navigation_m: Float[np.ndarray, "row column"] | None = None
    mapped: Mapped | None = None
    microrelief_m: float = MICRORELIEF_M

    @property
    def named(self) -> str:
        """The source in messages."""
        return f"{KEY} = {shown(self.name)}"

    def on_map(self, grid: Grid, microrelief_m: float) -> "Source":
        """Return the source with a surface."""
        if self.mapped is None:
            return self
        surface, sigma_m = self.mapped(grid, microrelief_m)
        return replace(self, surface=surface, sigma_m=sigma_m)


def read_sources(
    paths: Sequence[Path], sigma_m: float | Mapping[str, float] | None, overrides: Mapping[str, Any]
) -> list[Source]:
    """Return the sources in the order of their names; InputFileError, ScenarioError as `fuse`."""
    # In one order, whatever that of the arguments.
    paths = sorted((path.expanduser() for path in paths), key=lambda path: (path.name, str(path)))
    if not 2 <= len(paths) <= MAX_SOURCES:
        raise ScenarioError.of_option("SOURCE", f"{len(paths)} sources; give 2 to {MAX_SOURCES} of them")
    if len({path.resolve() for path in paths}) < len(paths):
        raise ScenarioError.of_option("SOURCE", "the same source is given twice; give it once")
    unique = len({path.name for path in paths}) == len(paths)
    stated = dict(sigma_m) if isinstance(sigma_m, Mapping) else {str(path): sigma_m for path in paths}
    if unknown := stated.keys() - {str(path) for path in paths}:
        raise ScenarioError.of_option("--sigma", f"{min(unknown)!r} is no source; name one as it is given")
    for value in stated.values():
        if value is not None and not 0 < value <= 1e4:
            raise ScenarioError.of_option("--sigma", f"{value:g} must be greater than 0 and at most 10000, in m")
    if overrides and not any(path.suffix.lower() in RECORDINGS for path in paths):
        raise ScenarioError.of_option("--set", "no source is a recording, which it would be for; leave it out")
    return [_read(path, path.name if unique else str(path), stated.get(str(path)), overrides) for path in paths]


def _read(path: Path, name: str, sigma_m: float | None, overrides: Mapping[str, Any]) -> Source:
    suffix = path.suffix.lower()
    if is_folder(path):
        return _folder(path, name)
    if suffix in RECORDINGS:
        return _recording(path, name, overrides)
    if suffix in CLOUDS:
        return _cloud(path, name, sigma_m)
    return _raster(path, name, "raster", path.with_name(f"{path.stem}_sigma{path.suffix}"), sigma_m)


def _folder(path: Path, name: str) -> Source:
    """Return the DEM of a folder of results."""
    dem, sigma, navigation = (path / f"{each}.tif" for each in ("dem", "dem_sigma", "dem_sigma_navigation"))
    if not (dem.is_file() and sigma.is_file()):
        message = "holds no dem.tif with its dem_sigma.tif"
        raise InputFileError(f"{KEY} = {shown(path)} {message}; {REMEDY}")
    source = replace(_raster(dem, name, "survey", sigma, None), microrelief_m=_microrelief_of(path))
    if navigation.is_file():
        source = replace(source, navigation_m=_same_cells(navigation, dem))
    return source


def _microrelief_of(folder: Path) -> float:
    """Return the microrelief of the ground of a survey; that of measured ground where its settings do not tell."""
    try:
        scenario = parse_scenario(parse_toml(read_text(folder / "scenario.toml", "settings =", REMEDY)))
    except (RadarError, ValueError):
        return MICRORELIEF_M
    if scenario.dem.microrelief_m is not None:
        return scenario.dem.microrelief_m
    return MICRORELIEF_M if scenario.measured_ground else 0.0


def _recording(path: Path, name: str, overrides: Mapping[str, Any]) -> Source:
    """Return the DEM of a recording."""
    made = process(path, overrides)
    if made.dem is None or made.dem_sigma is None or not made.dem.filled.any():
        raise InputFileError(
            f"{KEY} = {shown(path)}: its processing gives no DEM with a standard deviation; "
            "give a recording with poses, or another dem.method with --set"
        )
    place, scenario = made.dem.grid.georeference, made.scenario
    absolute = replace(made.dem, height_m=made.dem.map_height_m)
    west, east, south, north = made.dem.grid.extent_m
    x, y = place.origin_m[:2] if place else (0.0, 0.0)
    microrelief_m = made.settings.dem.microrelief_m
    if microrelief_m is None:
        microrelief_m = MICRORELIEF_M if scenario is None or scenario.measured_ground else 0.0
    return Source(
        name=name,
        kind="recording",
        crs=CRS.from_wkt(place.crs_wkt) if place else None,
        extent_m=(west + x, south + y, east + x, north + y),
        spacing_m=made.dem.grid.spacing_m,
        surface=ReferenceSurface.of(absolute),
        sigma_m=made.dem_sigma.height_m[::-1],
        microrelief_m=microrelief_m,
    )


def _heights(path: Path) -> tuple[Float[np.ndarray, "row column"], Affine, CRS | None, float]:
    """Return the first band of a raster in metres, NaN for none, its transform, its CRS and the band's unit in m."""
    named = f"{KEY} = {shown(path)}"
    with open_raster(path, KEY) as file:
        require_cells(file, named, "heights")
        if file.width * file.height > MAX_READ_CELLS:
            cells = f"{file.width:,} x {file.height:,} cells, more than {MAX_READ_CELLS:,}"
            raise InputFileError(f"{named} has {cells}; cut out a part with gdal_translate -projwin")
        crs = CRS.from_wkt(file.crs.to_wkt()) if file.crs else None
        unit_m = 1.0 if crs is None else height_system(file.units[0], crs, None, None).unit_m
        stored = file.read(1, masked=True, out_dtype="float64").filled(np.nan)
        stored[stored == UNDECLARED_NODATA] = np.nan
        height_m = stored * unit_m
        height_m[~(np.abs(height_m) <= MAX_HEIGHT_M)] = np.nan
        return height_m, file.transform, crs, unit_m


def _same_cells(path: Path, dem: Path) -> Float[np.ndarray, "row column"]:
    """Return the standard deviations of the cells of a DEM; InputFileError for other cells, and negative values."""
    value, transform, _, _ = _heights(path)
    with open_raster(dem, KEY) as file:
        if (file.height, file.width) != value.shape or not transform.almost_equals(file.transform, 1e-6):
            raise InputFileError(f"{KEY} = {shown(path)} has other cells than {dem.name}; write both on the same cells")
    if (value < 0).any():
        raise InputFileError(f"{KEY} = {shown(path)} holds negative standard deviations; give them in m")
    return value


def _raster(path: Path, name: str, kind: Kind, sigma: Path, stated_m: float | None) -> Source:
    height_m, transform, crs, _ = _heights(path)
    named = f"{KEY} = {shown(path)}"
    if not np.isfinite(height_m).any():
        raise InputFileError(f"{named} has no filled cell; {REMEDY}")
    if stated_m is not None:
        sigma_m = np.full(height_m.shape, stated_m)
    elif sigma.is_file():
        sigma_m = _same_cells(sigma, path)
    else:
        message = f"has no standard deviation: there is no {sigma.name} beside it"
        raise InputFileError(f"{named} {message}; write one, or state it with --sigma M")
    rows, columns = height_m.shape
    corner = np.array([*product((0.0, float(columns)), (0.0, float(rows)))])
    x, y = apply_affine(transform, *corner.T)
    square = transform.b == transform.d == 0 and np.isclose(transform.a, -transform.e)
    flat = ReferenceSurface.of(Raster.from_array(np.zeros((2, 2)), 1.0))
    surface = ReferenceSurface(
        kind="raster",
        height_m=height_m,
        transform=transform,
        crs=flat.crs if crs is None else horizontal_crs(crs).to_wkt(),
        sigma_m=0.0,
    )
    return Source(
        name=name,
        kind=kind,
        crs=crs,
        extent_m=(float(x.min()), float(y.min()), float(x.max()), float(y.max())),
        spacing_m=float(transform.a) if square else None,
        surface=surface,
        sigma_m=np.where(np.isfinite(height_m), sigma_m, np.nan),
    )


def _cloud(path: Path, name: str, stated_m: float | None) -> Source:
    with open_cloud(path, KEY) as cloud:
        dimensions = [d for d in SIGMA_DIMENSIONS if d in cloud.reader.header.point_format.extra_dimension_names]
        if stated_m is None and not dimensions:
            message = f"has no standard deviation: no extra dimension {' or '.join(SIGMA_DIMENSIONS)}"
            raise InputFileError(f"{cloud.name} {message}; state it with --sigma M")
        crs = CRS.from_wkt(cloud.crs_wkt) if cloud.crs_wkt else None
        unit_m = 1.0 if crs is None else cloud_height_system(crs, key=KEY).unit_m

        def as_they_are(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return x, y

        def pieces(dimension: str | None = None) -> Piece:
            place, value = zip(*cloud.pieces(choice, as_they_are, unit_m, dimension), strict=True)
            return np.concatenate(place), np.concatenate(value).astype(float)

        choice: Literal["all", "ground", "first"] = "all"
        choice = "ground" if (pieces("classification")[1] == GROUND_CLASS).any() else "first"
        place, height_m = pieces()
        sigma_m = np.full(len(height_m), stated_m) if stated_m is not None else pieces(dimensions[0])[1]
        if not (np.isfinite(sigma_m).all() and (sigma_m >= 0).all()):
            raise InputFileError(f"{cloud.name}: {dimensions[0]} holds values that are no standard deviations; mend it")
        extent_m = cloud.extent_m(as_they_are)

    def mapped(grid: Grid, microrelief_m: float) -> tuple[ReferenceSurface, Float[np.ndarray, "row column"]]:
        return _mapped(f"{KEY} = {shown(path)}", _local(place, crs, grid), height_m, sigma_m, grid, microrelief_m)

    return Source(name=name, kind="cloud", crs=crs, extent_m=extent_m, mapped=mapped)


def _local(place: Float[np.ndarray, "n 2"], crs: CRS | None, grid: Grid) -> Float[np.ndarray, "n 2"]:
    """Return places in the local metres of a grid."""
    if crs is None or grid.georeference is None:
        return place
    frame = MapFrame(
        crs=horizontal_crs(CRS.from_wkt(grid.georeference.crs_wkt)), origin_m=grid.georeference.origin_m[:2]
    )
    return np.column_stack(frame.local_of(horizontal_crs(crs), *place.T))


def _mapped(
    named: str,
    place_m: Float[np.ndarray, "n 2"],
    height_m: Float[np.ndarray, " n"],
    sigma_m: Float[np.ndarray, " n"],
    grid: Grid,
    microrelief_m: float,
) -> tuple[ReferenceSurface, Float[np.ndarray, "row column"]]:
    """Map a cloud on a grid, by the mean of the points in each cell."""
    row, column, inside = grid.cell_of(place_m)
    cell, group, count = np.unique((row * grid.columns + column)[inside], return_inverse=True, return_counts=True)
    if not MIN_PULSES <= len(cell) <= MAX_CLOUD_CELLS:
        remedy = "give more points" if len(cell) < MIN_PULSES else "raise --spacing, or cut out a part"
        raise InputFileError(
            f"{named} has points in {len(cell):,} cells, not {MIN_PULSES} to {MAX_CLOUD_CELLS:,}; {remedy}"
        )

    def mean(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " cell"]:
        return np.bincount(group, values[inside]) / count

    position_m = np.column_stack([mean(place_m[:, 0]), mean(place_m[:, 1]), mean(height_m)])
    number = np.arange(len(cell))
    points = Points(
        pulse=number,
        number=np.zeros_like(number),
        position_m=position_m,
        origin_m=position_m + np.array([0.0, 0.0, ABOVE_M]),
        range_m=np.full(len(cell), ABOVE_M),
        range_sigma_m=np.sqrt(mean(sigma_m**2) / count),
        power=np.ones(len(cell)),
        echo_snr_db=np.zeros(len(cell)),
    )
    inputs = MapInputs(
        points=points,
        sightings=None,
        grid=grid,
        max_gap_m=GAP_CELLS * grid.spacing_m,
        shadow_incidence_rad=np.pi / 2,
        microrelief_m=microrelief_m,
    )
    estimate = Smooth()(inputs)
    assert estimate.sigma is not None
    return ReferenceSurface.of(estimate.dem), estimate.sigma.height_m[::-1]


def common_grid(sources: Sequence[Source], spacing_m: float | None) -> Grid:
    """Return the cells of the fused DEM: those of the finest raster, over all sources.

    Raises InputFileError for sources whose coordinates or heights cannot be compared, ScenarioError without a spacing
    and for too many cells.
    """
    crs = _common_crs(sources)
    if spacing_m is not None and not 0 < spacing_m < 1e6:
        raise ScenarioError.of_option("--spacing", f"{spacing_m:g} must be greater than 0, in m")
    rasters = [s for s in sources if s.spacing_m is not None and _is_in(s, crs)]
    finest = min(rasters, key=lambda s: s.spacing_m or np.inf, default=None)
    if spacing_m is None:
        if finest is None or finest.spacing_m is None:
            raise ScenarioError.of_option("--spacing", "missing, and no source is a raster of square cells; give it, m")
        spacing_m = finest.spacing_m
    aligned = finest is not None and finest.spacing_m == spacing_m
    phase = (finest.extent_m[0] % spacing_m, finest.extent_m[1] % spacing_m) if aligned and finest else (0.0, 0.0)
    boxes = np.array([_extent_in(source, crs) for source in sources])
    low, high = boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)
    corner = np.floor((low - phase) / spacing_m + 1e-6) * spacing_m + phase
    columns, rows = np.ceil((high - corner) / spacing_m - 1e-6).astype(int).tolist()
    if rows * columns > MAX_DEM_CELLS:
        message = f"{spacing_m:g} m makes {columns:,} x {rows:,} cells, more than {MAX_DEM_CELLS:,}; raise it"
        raise ScenarioError.of_option("--spacing", message)
    half = spacing_m / 2
    if crs is None:
        west, south = (corner + half).tolist()
        return Grid(west_m=west, south_m=south, spacing_m=spacing_m, columns=columns, rows=rows)
    place = Georeference(crs_wkt=crs.to_wkt(), origin_m=(float(corner[0]), float(corner[1]), 0.0))
    return Grid(west_m=half, south_m=half, spacing_m=spacing_m, columns=columns, rows=rows, georeference=place)


def _is_in(source: Source, crs: CRS | None) -> bool:
    return crs is None or (source.crs is not None and horizontal_crs(source.crs) == horizontal_crs(crs))


def _extent_in(source: Source, crs: CRS | None) -> tuple[float, float, float, float]:
    if source.crs is None or crs is None or _is_in(source, crs):
        return source.extent_m
    west, south, east, north = source.extent_m
    corner = np.array([*product((west, east), (south, north))])
    try:
        x, y = reproject(horizontal_crs(source.crs), horizontal_crs(crs), *corner.T)
    except ProjError as error:
        raise InputFileError(f"{source.named}: its CRS cannot be transformed to {crs.name!r} ({error})") from error
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        message = f"lies outside of what {crs.name!r} can express"
        raise InputFileError(f"{source.named} {message}; convert it with gdalwarp -t_srs")
    return float(x.min()), float(y.min()), float(x.max()), float(y.max())


def _common_crs(sources: Sequence[Source]) -> CRS | None:
    """Return the CRS of the fused DEM; InputFileError where some have none, or datums differ."""
    placed = [source for source in sources if source.crs is not None]
    if not placed:
        return None
    if len(placed) < len(sources):
        other = next(source for source in sources if source.crs is None)
        message = f"has no CRS, and {placed[0].name} has one"
        raise InputFileError(f"{other.named} {message}; add it with gdal_translate -a_srs, or las2las")
    first = placed[0]
    for kind, datum in (("horizontal", _horizontal_datum), ("vertical", vertical_datum)):
        named = {source.name: datum(source.crs) for source in placed if source.crs is not None}
        known = [name for name, value in named.items() if value]
        first, other = known[0] if known else None, next((n for n in known if named[n] != named[known[0]]), None)
        if other is not None and first is not None:
            raise InputFileError(
                f"{KEY} = {shown(other)}: its {kind} datum is {named[other]}, and that of {first} {named[first]}; "
                "convert one of them with gdalwarp -s_srs and -t_srs, or pdal translate"
            )
        if known and len(known) < len(named):
            unknown = next(name for name in named if name not in known)
            warning = "%s: no vertical datum is stated; its heights are taken to count from %s, as those of %s"
            logger.warning(warning, unknown, named[known[0]], known[0])
    metric = [s.crs for s in placed if s.crs is not None and _in_metres(s.crs)]
    if not metric:
        message = f"is in {placed[0].crs.name!r}, and no source in projected metres" if placed[0].crs else ""
        raise InputFileError(f"{placed[0].named} {message}; convert one with gdalwarp -t_srs EPSG:<projected CRS>")
    # With the vertical datum, where one of them states it.
    horizontal = horizontal_crs(metric[0])
    whole = next((c for c in metric if vertical_datum(c) and horizontal_crs(c) == horizontal), metric[0])
    return height_system(None, whole, None, None).compound(horizontal)


def _horizontal_datum(crs: CRS) -> str | None:
    """Return the geodetic datum of a CRS; an ensemble of realisations has the name of their datum."""
    datum = crs.geodetic_crs.datum if crs.geodetic_crs else None
    return None if datum is None else datum.name.removesuffix(" ensemble")


def _in_metres(crs: CRS) -> bool:
    flat = horizontal_crs(crs)
    return bool(flat.is_projected and all(axis.unit_conversion_factor == 1 for axis in flat.axis_info))
