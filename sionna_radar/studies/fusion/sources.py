"""Reading the sources of a fusion: folders of results, recordings, point clouds and elevation rasters.

The DEM of a survey is taken rather than its points: it was made from whole echoes with the beam known, while a table of
points holds neither the footprints nor what the beam does to a range on a slope. Clouds of other sensors are mapped by
the method `smooth`, as the points of a lidar are. All sources are in one map, whose coordinates they keep.

A fusion may be a source. It records the digests of the files that it was made of, so that none of them counts twice.
"""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from pyproj import CRS

from sionna_radar.elevation.file_heights import MAX_HEIGHT_M
from sionna_radar.elevation.placed_raster import cloud_height_system, height_system, horizontal_crs, vertical_datum
from sionna_radar.elevation.point_cloud import GROUND_CLASS, Choice, Piece, open_cloud
from sionna_radar.foundation.errors import InputFileError, RadarError, ScenarioError
from sionna_radar.foundation.input_file import is_file, is_folder, shown
from sionna_radar.foundation.linear_algebra import on_one_thread
from sionna_radar.foundation.raster import MAX_READ_CELLS, Grid, Raster
from sionna_radar.foundation.raster_file import open_raster, read_square_cells
from sionna_radar.mapping.mapper import MAX_DEM_CELLS, MICRORELIEF_M, MapInputs
from sionna_radar.mapping.points import Points
from sionna_radar.mapping.refined.refinement import Smooth
from sionna_radar.mapping.tiles import MIN_PULSES
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.recorded import RecordedSettings, results_settings
from sionna_radar.studies.fusion.results import made_of
from sionna_radar.survey.reprocessing import process

logger = logging.getLogger("sionna_radar")

KEY, MAX_SOURCES = "source", 12
REMEDY = "give a folder of `run` or `process`, a recording (.nc, .toml), a LAS or LAZ cloud, or an elevation raster"
CONVERT = "convert one with gdalwarp -s_srs and -t_srs, or pdal translate"
RECORDINGS, CLOUDS = (".nc", ".toml"), (".las", ".laz")
# Extra dimensions of clouds that hold the standard deviation of each point, m; the second is of this program.
SIGMA_DIMENSIONS = ("sigma_m", "range_sigma_m")
# Cells with points of the largest cloud.
MAX_CLOUD_CELLS = 200_000
# Gaps of a cloud narrower than this many cells are closed.
GAP_CELLS = 3.0
# A cloud counts as seen straight from above, from this height over its points, m.
ABOVE_M = 1000.0

Cells = Float[np.ndarray, "row column"]


@dataclass(frozen=True, kw_only=True)
class Source:
    """Heights of one sensor in the coordinates of its map, over its vertical datum, m.

    crs: with the vertical part where it is known; None for local metres.
    extent_m: west, east, south and north.
    dem, sigma_m: heights, and their standard deviations on the same cells; None for a cloud that is not mapped yet.
    navigation_m: what errors of navigation add, common to neighbouring cells; None if it is not stated.
    points: those of a cloud.
    microrelief_m: of the ground; see `Mapper`.
    made_of: names of the measurements that it holds by the digest of their files: its own, and of a fusion those that
        were fused.
    """

    name: str
    kind: str
    crs: CRS | None
    extent_m: tuple[float, float, float, float]
    dem: Raster | None = None
    sigma_m: Cells | None = None
    navigation_m: Cells | None = None
    points: Points | None = None
    microrelief_m: float = MICRORELIEF_M
    made_of: Mapping[str, str] = field(default_factory=dict)

    @property
    def named(self) -> str:
        """The source in messages."""
        return f"{KEY} = {shown(self.name)}"


def sorted_paths(paths: Sequence[str | Path]) -> list[Path]:
    """Return the paths of sources in the order of a fusion, whatever that of the arguments."""
    return sorted((Path(path) for path in paths), key=lambda path: (path.name, str(path)))


def read_sources(
    paths: Sequence[Path], sigma_m: float | Mapping[str, float] | None, overrides: Mapping[str, Any]
) -> list[Source]:
    """Return the sources, in the order of the paths; InputFileError, ScenarioError as `fuse`."""
    if not 2 <= len(paths) <= MAX_SOURCES:
        raise ScenarioError.of_option("SOURCE", f"{len(paths)} sources; give 2 to {MAX_SOURCES} of them")
    if len({path.resolve() for path in paths}) < len(paths):
        raise ScenarioError.of_option("SOURCE", "the same source is given twice; give it once")
    stated = dict(sigma_m) if isinstance(sigma_m, Mapping) else {}
    if unknown := stated.keys() - {str(path) for path in paths}:
        raise ScenarioError.of_option("--sigma", f"{min(unknown)!r} is no source; name one as it is given")
    usual_m = None if isinstance(sigma_m, Mapping) else sigma_m
    for value in [*stated.values(), usual_m]:
        if value is not None and not 0 < value <= 1e4:
            raise ScenarioError.of_option("--sigma", f"{value:g} must be greater than 0 and at most 10000, in m")
    if overrides and not any(path.suffix.lower() in RECORDINGS for path in paths):
        raise ScenarioError.of_option("--set", "no source is a recording, which it would be for; leave it out")
    unique = len({path.name for path in paths}) == len(paths)
    sources = []
    for path in paths:
        name, suffix = path.name if unique else str(path), path.suffix.lower()
        given = stated.get(str(path)), usual_m
        if str(path) in stated and (is_folder(path) or suffix in RECORDINGS):
            message = f"{shown(path)} has a standard deviation for each cell; leave it out, or give its DEM as a raster"
            raise ScenarioError.of_option("--sigma", message)
        if is_folder(path):
            sources.append(_folder(path, name))
        elif suffix in RECORDINGS:
            sources.append(_recording(path, name, overrides))
        elif suffix in CLOUDS:
            sources.append(_cloud(path, name, *given))
        else:
            sources.append(_raster(path, name, path.with_name(f"{path.stem}_sigma{path.suffix}"), *given))
    sources = [replace(source, made_of=made_of(path, source.name)) for path, source in zip(paths, sources, strict=True)]
    _refuse_double(sources)
    return sources


def _refuse_double(sources: Sequence[Source]) -> None:
    """Raise ScenarioError for a measurement that a fusion holds and another source is, or holds, too."""
    for one, other in combinations(sources, 2):
        fusions = [source for source in (one, other) if len(source.made_of) > 1]
        common = one.made_of.keys() & other.made_of.keys()
        if fusions and common:
            first, second = fusions[0], other if fusions[0] is one else one
            held = next(name for digest, name in first.made_of.items() if digest in common)
            message = f"{first.name!r} is a fusion that holds {held!r}, as {second.name!r} does; it would count twice"
            raise ScenarioError.of_option("SOURCE", f"{message}; leave one of them out, or fuse all single sources")


def _folder(path: Path, name: str) -> Source:
    dem, sigma, navigation = (path / f"{each}.tif" for each in ("dem", "dem_sigma", "dem_sigma_navigation"))
    if not (is_file(dem) and is_file(sigma)):
        raise InputFileError(f"{KEY} = {shown(path)} holds no dem.tif with its dem_sigma.tif; {REMEDY}")
    try:
        microrelief_m = _microrelief_m(results_settings(path, REMEDY))
    except RadarError:  # of a folder that holds a part of another package
        microrelief_m = MICRORELIEF_M
    source = replace(_raster(dem, name, sigma), kind="survey", microrelief_m=microrelief_m)
    if is_file(navigation) and source.dem is not None:
        source = replace(source, navigation_m=_same_cells(navigation, source.dem.grid))
    return source


def _microrelief_m(settings: Scenario | RecordedSettings) -> float:
    if settings.dem.microrelief_m is not None:
        return settings.dem.microrelief_m
    return MICRORELIEF_M if not isinstance(settings, Scenario) or settings.measured_ground else 0.0


def _recording(path: Path, name: str, overrides: Mapping[str, Any]) -> Source:
    made = process(path, overrides)
    if made.dem is None or made.dem_sigma is None or not made.dem.filled.any():
        message = "its processing gives no DEM with a standard deviation; give one with poses, or another dem.method"
        raise InputFileError(f"{KEY} = {shown(path)}: {message}")
    grid, place = made.dem.grid, made.dem.grid.georeference
    east_m, north_m = place.origin_m[:2] if place else (0.0, 0.0)
    grid = replace(grid, west_m=grid.west_m + east_m, south_m=grid.south_m + north_m, georeference=None)
    return Source(
        name=name,
        kind="recording",
        crs=CRS.from_wkt(place.crs_wkt) if place else None,
        extent_m=grid.extent_m,
        dem=Raster(grid=grid, height_m=made.dem.map_height_m),
        sigma_m=made.dem_sigma.height_m,
        microrelief_m=_microrelief_m(made.settings),
    )


def _read_raster(path: Path) -> tuple[Raster, CRS | None]:
    """Return the first band of a raster in metres, and its CRS."""
    named = f"{KEY} = {shown(path)}"
    with open_raster(path, KEY) as file:
        cells = read_square_cells(file, named, f"{REMEDY}, with gdalwarp -t_srs -tr", MAX_READ_CELLS)
        crs = CRS.from_wkt(file.crs.to_wkt()) if file.crs else None
        unit_m = height_system(file.units[0], crs, None, None).unit_m if crs else 1.0
    height_m = cells.height_m.astype(float) * unit_m
    height_m[np.abs(height_m) > MAX_HEIGHT_M] = np.nan
    return Raster.from_array(height_m, cells.spacing_m, west_m=cells.west_m, south_m=cells.south_m), crs


def _same_cells(path: Path, grid: Grid) -> Cells:
    """Return the standard deviations of the cells of a DEM; InputFileError for other cells, and negative values."""
    raster, _ = _read_raster(path)
    if raster.grid != grid:
        raise InputFileError(f"{KEY} = {shown(path)} has other cells than its DEM; write both on the same cells")
    if (raster.height_m < 0).any():
        raise InputFileError(f"{KEY} = {shown(path)} holds negative standard deviations; give them in m")
    return raster.height_m


def _raster(path: Path, name: str, sigma: Path, stated_m: float | None = None, usual_m: float | None = None) -> Source:
    """Return a raster, with the stated standard deviation, or that of a file beside it, or the usual one."""
    dem, crs = _read_raster(path)
    if not dem.filled.any():
        raise InputFileError(f"{KEY} = {shown(path)} has no filled cell; {REMEDY}")
    if stated_m is None and is_file(sigma):
        sigma_m = _same_cells(sigma, dem.grid)
        if not (sigma_m[dem.filled] > 0).any():
            message = "states a standard deviation of zero or none for each height; give them in m, or --sigma M"
            raise InputFileError(f"{KEY} = {shown(sigma)} {message}")
    elif (stated_m := stated_m or usual_m) is not None:
        sigma_m = np.full(dem.grid.shape, stated_m)
    else:
        message = f"has no standard deviation: no {sigma.name} is beside it; write one, or state it with --sigma M"
        raise InputFileError(f"{KEY} = {shown(path)} {message}")
    return Source(name=name, kind="raster", crs=crs, extent_m=dem.grid.extent_m, dem=dem, sigma_m=sigma_m)


def _cloud(path: Path, name: str, stated_m: float | None, usual_m: float | None) -> Source:
    """Return the ground points of a cloud, or without any classified so its first returns."""
    with open_cloud(path, KEY) as cloud:
        crs = CRS.from_wkt(cloud.crs_wkt) if cloud.crs_wkt else None
        unit_m = cloud_height_system(crs, key=KEY).unit_m if crs else 1.0

        def read(choice: Choice, dimension: str | None = None) -> Piece:
            place, value = zip(*cloud.pieces(choice, lambda x, y: (x, y), unit_m, dimension), strict=True)
            return np.concatenate(place), np.concatenate(value).astype(float)

        choice: Choice = "ground" if (read("all", "classification")[1] == GROUND_CLASS).any() else "first"
        place_m, height_m = read(choice)
        known = set(cloud.reader.header.point_format.extra_dimension_names)
        dimension = next((each for each in SIGMA_DIMENSIONS if each in known), None)
        if stated_m is None and dimension is not None:
            sigma_m = read(choice, dimension)[1]
        elif (stated_m := stated_m or usual_m) is not None:
            sigma_m = np.full(len(height_m), stated_m)
        else:
            message = f"has no standard deviation: no dimension {' or '.join(SIGMA_DIMENSIONS)}"
            raise InputFileError(f"{cloud.name} {message}; state it with --sigma M")
    if len(height_m) == 0 or not (sigma_m >= 0).all() or not np.isfinite(sigma_m).all():
        raise InputFileError(f"{cloud.name}: {dimension} holds values that are no standard deviations; correct it")
    number = np.arange(len(height_m))
    points = Points(
        pulse=number,
        number=np.zeros_like(number),
        position_m=np.column_stack([place_m, height_m]),
        origin_m=np.column_stack([place_m, height_m + ABOVE_M]),
        range_m=np.full(len(number), ABOVE_M),
        range_sigma_m=sigma_m,
        power=np.ones(len(number)),
        echo_snr_db=np.zeros(len(number)),
    )
    (west, south), (east, north) = place_m.min(axis=0).tolist(), place_m.max(axis=0).tolist()
    return Source(name=name, kind="cloud", crs=crs, extent_m=(west, east, south, north), points=points)


@on_one_thread
def mapped(source: Source, grid: Grid, microrelief_m: float) -> Source:
    """Return a source with a DEM: a cloud is mapped from the mean of its points in each cell."""
    points = source.points
    if points is None:
        return source
    row, column, inside = grid.cell_of(points.position_m)
    _, first, group, count = np.unique(
        (row * grid.columns + column)[inside], return_index=True, return_inverse=True, return_counts=True
    )
    if not MIN_PULSES <= len(count) <= MAX_CLOUD_CELLS:
        remedy = "give more points" if len(count) < MIN_PULSES else "raise --spacing, or cut out a part"
        message = f"has points in {len(count):,} cells, not {MIN_PULSES} to {MAX_CLOUD_CELLS:,}; {remedy}"
        raise InputFileError(f"{source.named} {message}")

    def mean(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " cell"]:
        return np.bincount(group, values[inside]) / count

    position_m = np.column_stack([mean(axis) for axis in points.position_m.T])
    means = replace(
        points.rows(np.flatnonzero(inside)[first]),
        position_m=position_m,
        origin_m=position_m + np.array([0.0, 0.0, ABOVE_M]),
        range_sigma_m=np.sqrt(mean(points.range_sigma_m**2) / count),
    )
    inputs = MapInputs(
        points=means,
        sightings=None,
        grid=grid,
        max_gap_m=GAP_CELLS * grid.spacing_m,
        shadow_incidence_rad=np.pi / 2,
        microrelief_m=microrelief_m,
    )
    estimate = Smooth()(inputs)
    assert estimate.sigma is not None
    return replace(source, dem=estimate.dem, sigma_m=estimate.sigma.height_m)


def common_grid(sources: Sequence[Source], spacing_m: float | None) -> tuple[Grid, CRS | None]:
    """Return the cells of the fused DEM, those of the finest raster, over all sources in their map; and its CRS.

    Raises InputFileError for sources in different maps or datums, ScenarioError without a spacing or for too many
    cells.
    """
    crs = _common_crs(sources)
    finest = min((s.dem.grid for s in sources if s.dem), key=lambda grid: grid.spacing_m, default=None)
    if spacing_m is None and finest is None:
        raise ScenarioError.of_option("--spacing", "missing, and no source is a raster; give the size of the cells, m")
    if spacing_m is not None and not 0 < spacing_m < 1e6:
        raise ScenarioError.of_option("--spacing", f"{spacing_m:g} must be greater than 0 and less than 1e6, in m")
    west, east, south, north = np.array([source.extent_m for source in sources]).T
    low, high = np.array([west.min(), south.min()]), np.array([east.max(), north.max()])
    aligned = finest is not None and spacing_m in (None, finest.spacing_m)
    spacing_m = finest.spacing_m if finest is not None and aligned else float(spacing_m or 0.0)
    edge = np.array(finest.extent_m[::2]) if finest is not None and aligned else np.zeros(2)
    # A millionth of a cell is rounding.
    first = np.floor((low - edge) / spacing_m + 1e-6)
    columns, rows = np.ceil((high - edge) / spacing_m - first - 1e-6).tolist()
    if rows * columns > MAX_DEM_CELLS:
        message = f"{spacing_m:g} m makes {columns:,.0f} x {rows:,.0f} cells, more than {MAX_DEM_CELLS:,}; raise it"
        raise ScenarioError.of_option("--spacing", message)
    west_m, south_m = (edge + (first + 0.5) * spacing_m).tolist()
    columns, rows = max(int(columns), 1), max(int(rows), 1)
    return Grid(west_m=west_m, south_m=south_m, spacing_m=spacing_m, columns=columns, rows=rows), crs


def _common_crs(sources: Sequence[Source]) -> CRS | None:
    """Return the CRS of all sources; InputFileError where some have none, or they differ."""
    first, *others = sources
    for other in others:
        if (first.crs is None) != (other.crs is None):
            without, placed = (other, first) if other.crs is None else (first, other)
            message = f"has no CRS, and {placed.name} has one; add it with gdal_translate -a_srs, or las2las"
            raise InputFileError(f"{without.named} {message}")
        if first.crs is None or other.crs is None:
            continue
        ours, theirs = horizontal_crs(first.crs), horizontal_crs(other.crs)
        if not ours.equals(theirs, ignore_axis_order=True):
            raise InputFileError(f"{other.named} is in {theirs.name!r}, and {first.name} in {ours.name!r}; {CONVERT}")
    if first.crs is None:
        return None
    flat = horizontal_crs(first.crs)
    if not flat.is_projected or any(axis.unit_conversion_factor != 1 for axis in flat.axis_info):
        message = f"is in {flat.name!r}, not in metres; convert all sources with gdalwarp -t_srs EPSG:<projected CRS>"
        raise InputFileError(f"{first.named} {message}")
    datum = {source.name: vertical_datum(source.crs) for source in sources if source.crs is not None}
    known = [source for source in sources if datum[source.name]]
    for source in sources:
        if known and datum[source.name] is None:
            warning = "%s: no vertical datum is stated; its heights are taken to count from %s, as those of %s"
            logger.warning(warning, source.name, datum[known[0].name], known[0].name)
        elif known and datum[source.name] != datum[known[0].name]:
            message = f"heights count from {datum[source.name]}, and those of {known[0].name} from"
            raise InputFileError(f"{source.named}: its {message} {datum[known[0].name]}; {CONVERT}")
    whole = known[0].crs if known else first.crs
    assert whole is not None
    return height_system(None, whole, None, None).compound(flat)
