"""Comparison of a DEM with measured heights: an elevation raster, a point cloud, or checkpoints.

The shift between the two is estimated first. With the DEM h and the reference z,

    h(x) = z(x - d) + u + t . (x - x0) + errors,

d being the horizontal shift of the DEM against the reference, u the vertical one, t a tilt and x0 the middle of the
DEM. It is linearised by the slopes, as by Nuth and Kaeaeb (2011, "Co-registration and bias corrections of satellite
elevation data sets for quantifying glacier thickness change", The Cryosphere 5, 271-290), and iterated.

The slopes contain noise, from which least squares derive a shift even of flat ground. So the slopes of the DEM are the
instruments of those of the reference, whose errors are independent of them: theta = (Z'X)^-1 Z'r. Where the two have no
relief in common, the standard deviation of d grows without bound. Neighbouring errors are alike, as far as the relief
is: standard deviations are those of estimates without one of eight parts of the map (`accuracy.robust_errors`).
"""

import logging
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from pyproj import CRS
from pyproj.exceptions import CRSError
from rasterio.transform import Affine
from rasterio.warp import Resampling, reproject

from sionna_radar.accuracy.breakdown import Breakdown, break_down
from sionna_radar.accuracy.checkpoints import gradient
from sionna_radar.accuracy.compare import DemError, nmad, statistics
from sionna_radar.accuracy.illumination import Walls, raster_walls
from sionna_radar.accuracy.robust_errors import BLOCKS, blocks_of, robust_fit
from sionna_radar.accuracy.uncertainty import Calibration, UncertaintyCheck, calibration, check_uncertainty
from sionna_radar.elevation.file_heights import MAX_HEIGHT_M, UNDECLARED_NODATA
from sionna_radar.elevation.local_frame import MapFrame
from sionna_radar.elevation.placed_raster import (
    apply_affine,
    cloud_height_system,
    height_system,
    horizontal_crs,
    vertical_datum,
)
from sionna_radar.elevation.placed_raster import reproject as convert
from sionna_radar.elevation.point_cloud import COVERS, Piece, gridded, majority, open_cloud
from sionna_radar.foundation.bounds import check_bounds
from sionna_radar.foundation.errors import InputFileError, reason_of
from sionna_radar.foundation.input_file import read_numbers, shown
from sionna_radar.foundation.raster import Grid, Raster, spans
from sionna_radar.foundation.raster_file import open_raster, require_cells
from sionna_radar.inference.terrain.uncertainty import Uncertainty
from sionna_radar.mapping.points import Points

logger = logging.getLogger("sionna_radar")

KEY = "reference"
REMEDY = "give a GeoTIFF, a LAS or LAZ file, or a CSV file with the columns x, y, z and, if known, sigma"
# Largest shift that is searched, m, and the number of trial shifts to each side of none.
SEARCHED_M, TRIALS = 20.0, 5
MAX_ITERATIONS = 20
# Residuals beyond this many NMAD do not take part in the estimate of the shift.
OUTLIERS = 4.0
# Fewest common cells of which a shift is estimated.
MIN_CELLS = 60
# Fewest checkpoints from which a tilt is estimated, and an offset.
TILT_CHECKPOINTS, OFFSET_CHECKPOINTS = 10, 3
# Least fraction of cells with points at which a cloud counts as a surface.
MIN_FILLED_FRACTION = 0.5


@dataclass(frozen=True, kw_only=True)
class Shift:
    """Shift of a DEM against a reference, with standard deviations; None where it was not estimated.

    The standard deviations come from few parts of the map; 1.96 of them to either side are an interval of 95 %.

    east_m, north_m: horizontal; None for checkpoints, and where the relief does not determine it.
    up_m: vertical, in the middle of the DEM.
    tilt_east, tilt_north: slopes of the difference, m per m.
    rms_m, shifted_rms_m: of DEM minus reference, without outliers, before and after the shift is taken out.
    """

    up_m: float
    up_sigma_m: float
    east_m: float | None = None
    north_m: float | None = None
    east_sigma_m: float | None = None
    north_sigma_m: float | None = None
    tilt_east: float | None = None
    tilt_north: float | None = None
    tilt_east_sigma: float | None = None
    tilt_north_sigma: float | None = None
    rms_m: float
    shifted_rms_m: float

    def trend_m(self, place_m: Float[np.ndarray, "n 2"], middle_m: Float[np.ndarray, "2"]) -> Float[np.ndarray, " n"]:
        """Return the vertical shift and tilt at places."""
        tilt = np.array([self.tilt_east or 0.0, self.tilt_north or 0.0])
        return self.up_m + (place_m - middle_m) @ tilt


@dataclass(frozen=True, kw_only=True)
class ReferenceSurface:
    """Measured heights on cells of their own.

    height_m: heights over the local origin, rows from north to south; transform: from columns and rows to `crs`.
    sigma_m: their standard deviation; 0 if unknown.
    cover: number of each cell in `COVERS`, NaN for none; None if it is not known.
    """

    kind: Literal["raster", "cloud"]
    height_m: Float[np.ndarray, "row column"]
    transform: Affine
    crs: str
    sigma_m: float
    cover: Float[np.ndarray, "row column"] | None = None

    @classmethod
    def of(cls, raster: Raster) -> "ReferenceSurface":
        """Return a raster as a surface, its own standard deviation unknown."""
        transform, crs = Affine(*raster.grid.transform), _crs_of(raster.grid)
        return cls(kind="raster", height_m=raster.height_m[::-1], transform=transform, crs=crs, sigma_m=0.0)

    def on(self, grid: Grid, shift_m: tuple[float, float] = (0.0, 0.0), of: np.ndarray | None = None) -> Raster:
        """Return the heights on a grid, moved by a horizontal shift, or other values of the cells.

        Heights are bilinear, NaN next to empty cells; other values those of the nearest cell.
        """
        a, b, c, d, e, f = grid.transform
        out = np.full(grid.shape, np.nan)
        reproject(
            self.height_m if of is None else of,
            out,
            src_transform=self.transform,
            src_crs=self.crs,
            dst_transform=Affine(a, b, c - shift_m[0], d, e, f - shift_m[1]),
            dst_crs=_crs_of(grid),
            src_nodata=np.nan,
            dst_nodata=np.nan,
            resampling=Resampling.bilinear if of is None else Resampling.nearest,
        )
        return Raster(grid=grid, height_m=out[::-1])

    def own_cells(self, grid: Grid) -> Grid:
        """Return cells over a grid that are as large as its own, if those are larger."""
        west, south, east, north = _extent_on(grid, self)
        spacing_m = max(grid.spacing_m, float(np.sqrt((east - west) * (north - south) / self.height_m.size)))
        west, east, south, north = grid.extent_m
        return replace(Grid.covering(west, south, east, north, spacing_m), georeference=grid.georeference)

    def covers(self, grid: Grid, shift_m: tuple[float, float]) -> dict[str, Bool[np.ndarray, "row column"]]:
        """Return the cells of each cover on a grid, moved by a horizontal shift; empty if none is known."""
        if self.cover is None:
            return {}
        number = self.on(grid, shift_m, self.cover).height_m
        return {
            name: number == class_number for class_number, name in enumerate(COVERS) if np.any(number == class_number)
        }

    def walls(self, grid: Grid, shift_m: tuple[float, float]) -> Walls:
        """Return the walls within a grid, moved by a horizontal shift: steps between the reference's own cells."""
        corner_m = np.array(list(product(*np.reshape(grid.extent_m, (2, 2))))) + _origin_m(grid)[:2] - shift_m
        reference_crs, theirs = CRS.from_wkt(self.crs), CRS.from_wkt(_crs_of(grid))
        at = np.floor(apply_affine(~self.transform, *convert(theirs, reference_crs, *corner_m.T)))
        (left, top), (right, bottom) = np.maximum([at.min(axis=1) - 1, at.max(axis=1) + 2], 0).astype(int)

        def place(row: Int[np.ndarray, " n"], column: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
            on_map = convert(reference_crs, theirs, *apply_affine(self.transform, column + left + 0.5, row + top + 0.5))
            return np.column_stack(on_map) - _origin_m(grid)[:2] + shift_m

        return raster_walls(self.height_m[top:bottom, left:right], place)


@dataclass(frozen=True, kw_only=True)
class Checkpoints:
    """Measured heights of single places, in local metres: of a table, or of a cloud too sparse for a surface.

    sigma_m: standard deviation of each height; 0 if unknown.
    """

    place_m: Float[np.ndarray, "n 2"]
    height_m: Float[np.ndarray, " n"]
    sigma_m: Float[np.ndarray, " n"]
    kind: Literal["checkpoints", "sparse cloud"] = "checkpoints"


@dataclass(frozen=True, kw_only=True)
class ReferenceCheck:
    """A DEM against measured heights.

    name: of the reference's file. sigma_m: its standard deviation, RMS; 0 if unknown.
    shift: as estimated; applied: whether it was taken out before the comparison.
    error: DEM minus reference, None for checkpoints. statistics: of lit cells, or of checkpoints.
    breakdown: None for checkpoints. calibration: errors over the stated standard deviations of DEM and reference
    together; None if the DEM states none.
    missing: breakdowns of the error that are not available, each with the reason.
    """

    name: str
    kind: str
    sigma_m: float
    shift: Shift
    applied: bool
    error: Raster | None
    statistics: DemError
    breakdown: Breakdown | None
    calibration: UncertaintyCheck | Calibration | None
    missing: dict[str, str]

    def document(self) -> dict[str, Any]:
        """Return all but the raster as nested tables; `missing` has the name `untold` in result files."""
        document = asdict(replace(self, error=None))
        document["untold"] = document.pop("missing")
        return document


def compare_with_reference(
    path: str | Path,
    dem: Raster,
    sigma: Raster | None = None,
    *,
    sigma_m: float = 0.0,
    apply_shift: bool = False,
    lit: Bool[np.ndarray, "row column"] | None = None,
    points: Points | None = None,
    uncertainty: Uncertainty | None = None,
    walls: Walls | None = None,
    covers: Mapping[str, Bool[np.ndarray, "row column"]] | None = None,
    seed: int = 0,
) -> ReferenceCheck:
    """Compare a DEM with the measured heights of a file.

    Parameters
    ----------
    path:
        An elevation raster, a LAS or LAZ cloud, or a CSV file with the columns x, y, z and, if known, sigma, in m.
    dem, sigma:
        The DEM and its stated standard deviation. A DEM in map coordinates needs a reference with a CRS; checkpoints
        have those of the DEM.
    sigma_m:
        Standard deviation of the reference's heights; the column sigma of checkpoints comes first.
    apply_shift:
        Whether the estimated shift is taken out before the comparison.
    lit:
        Cells that the main beam reached; None takes all filled ones.
    points, uncertainty:
        The located echoes, and the uncertainty of means, for classes of view and windows.
    walls, covers:
        Where they are, in the coordinates of the DEM, for classes of distance and of cover. Without them, walls are the
        steps between neighbouring cells of the reference, and covers the classes of a cloud's points.
    seed:
        Of the random choice of checkpoints among cells.

    Returns
    -------
    Shift, error statistics and breakdown of the DEM against the reference.

    Raises
    ------
    InputFileError
        The file cannot be read, does not fit the DEM's coordinates, or has no height where the DEM has any.

    Examples
    --------
    >>> survey = run(load_scenario("hills", {"platform.length_m": 10.0}))
    >>> survey.truth.to_geotiff("surveyed.tif")
    >>> check = compare_with_reference("surveyed.tif", survey.dem, survey.dem_sigma, lit=survey.lit)
    >>> abs(check.statistics.rms_m - survey.lit_error.rms_m) < 1e-4
    True
    """
    path = Path(path)
    reference = read_reference(path, dem.grid, sigma_m)
    if isinstance(reference, Checkpoints):
        return _check_at(path.name, reference, dem, sigma, apply_shift)
    reached = dem.filled if lit is None else lit
    shift = _shift_of(dem, reference, dem.filled & reached, path)
    moved_m = (shift.east_m or 0.0, shift.north_m or 0.0) if apply_shift else (0.0, 0.0)
    surface = reference.on(dem.grid, moved_m)
    _warn_of(shift, path.name, apply_shift)
    if apply_shift:
        trend = shift.trend_m(dem.grid.centres_m, _middle_m(dem.grid)).reshape(dem.grid.shape)
        surface = replace(surface, height_m=surface.height_m + trend)
    error = Raster(grid=dem.grid, height_m=dem.height_m - surface.height_m, quantity="height error")
    compared = reached & surface.filled
    total = None if sigma is None else replace(sigma, height_m=np.hypot(sigma.height_m, reference.sigma_m))
    covers = covers or reference.covers(dem.grid, moved_m)
    steps = "the scenario has none" if walls is not None else "no step of the reference is as high and steep"
    walls = reference.walls(dem.grid, moved_m) if walls is None else walls
    missing = {
        "incidence": "" if points else "no echoes",
        "distance from walls": "" if walls else steps,
        "cover": "" if covers else "no cover data in the scenario or the reference",
    }
    return ReferenceCheck(
        name=path.name,
        kind=reference.kind,
        sigma_m=reference.sigma_m,
        shift=shift,
        applied=apply_shift,
        error=error,
        statistics=statistics(error.height_m[error.filled & compared], int(compared.sum())),
        breakdown=break_down(
            error, surface, compared, points, walls, seed, checkpoint_sigma_m=reference.sigma_m, covers=covers
        ),
        calibration=None if total is None else check_uncertainty(error, total, surface, compared, points, uncertainty),
        missing={name: reason for name, reason in missing.items() if reason},
    )


def _warn_of(shift: Shift, name: str, applied: bool) -> None:
    """Warn of a vertical shift beyond which a single error would be an outlier."""
    if not applied and abs(shift.up_m) > OUTLIERS * max(shift.shifted_rms_m, shift.up_sigma_m):
        warning = "the DEM lies %+.2f m off %s, and the rest of its errors is %.2f m: look at vertical datum, unit and "
        warning += "range zero of both, or take the shift out"
        logger.warning(warning, shift.up_m, name, shift.shifted_rms_m)


def _check_at(
    name: str, reference: Checkpoints, dem: Raster, sigma: Raster | None, apply_shift: bool
) -> ReferenceCheck:
    """Compare a DEM with checkpoints."""
    height_m = dem.at(reference.place_m)
    inside = np.isfinite(height_m)
    error_m = (height_m - reference.height_m)[inside]
    if len(error_m) < OFFSET_CHECKPOINTS:
        raise InputFileError(
            f"{KEY} = {name}: {len(error_m)} of {len(inside)} places lie on filled cells of the DEM; "
            f"give at least {OFFSET_CHECKPOINTS}"
        )
    place_m, own_m = reference.place_m[inside], reference.sigma_m[inside]
    shift = _trend_of(error_m, place_m, _middle_m(dem.grid))
    _warn_of(shift, name, apply_shift)
    if apply_shift:
        error_m = error_m - shift.trend_m(place_m, _middle_m(dem.grid))
    stated = None if sigma is None else np.hypot(sigma.at(place_m), own_m)
    has_sigma = None if stated is None else np.isfinite(stated)
    return ReferenceCheck(
        name=name,
        kind=reference.kind,
        sigma_m=float(np.sqrt(np.mean(own_m**2))),
        shift=shift,
        applied=apply_shift,
        error=None,
        statistics=statistics(error_m, len(inside)),
        breakdown=None,
        calibration=None
        if stated is None or not np.any(has_sigma)
        else calibration(error_m[has_sigma], stated[has_sigma]),
        missing={"slope, incidence, distance from walls, cover, variogram": "checkpoints do not form a surface"},
    )


# ----------------------------------------------------------------------------------------------------------- shift
def _shift_of(dem: Raster, reference: ReferenceSurface, cells: Bool[np.ndarray, "row column"], path: Path) -> Shift:
    """Return the shift of a DEM against the surface of a file; InputFileError with too few common cells."""
    common_cells = int((cells & reference.on(dem.grid).filled).sum())
    if common_cells < MIN_CELLS:
        message = (
            f"{KEY} = {shown(path)}: has {common_cells} heights where the DEM has any; give a reference that covers it"
        )
        raise InputFileError(message)
    return shift_between(dem, reference, cells)


def shift_between(dem: Raster, reference: ReferenceSurface, cells: Bool[np.ndarray, "row column"]) -> Shift:
    """Return the shift of a DEM against a surface, without a horizontal one where the relief does not determine it.

    cells: those of the DEM from which it is estimated, `MIN_CELLS` of them common to both at least.
    """
    shift = _fitted(dem, reference, cells, _coarse_shift(dem, reference, cells))
    at_the_limit = max(abs(shift.east_m or 0.0), abs(shift.north_m or 0.0)) >= SEARCHED_M
    # Within a wider interval another trial shift fits as well.
    if at_the_limit or 2 * max(shift.east_sigma_m or 0.0, shift.north_sigma_m or 0.0) > SEARCHED_M / TRIALS:
        return _fitted(dem, reference, cells, None)
    return shift


def _fitted(
    dem: Raster,
    reference: ReferenceSurface,
    cells: Bool[np.ndarray, "row column"],
    start_m: Float[np.ndarray, "2"] | None,
) -> Shift:
    """Return the fitted shift, beginning with a horizontal one; without a horizontal one for None."""
    moved = start_m is not None
    shift_m = np.zeros(2) if start_m is None else start_m
    place = dem.grid.centres_m - _middle_m(dem.grid)
    constant = np.column_stack([np.ones(len(place)), place])
    slopes = [-component.ravel() for component in gradient(dem)]
    for _ in range(MAX_ITERATIONS if moved else 1):
        surface = reference.on(dem.grid, tuple(shift_m))
        residual = (dem.height_m - surface.height_m).ravel()
        own = [-component.ravel() for component in gradient(surface)]
        model = np.column_stack([*own, constant]) if moved else constant
        instruments = np.column_stack([*slopes, constant]) if moved else constant
        usable = cells.ravel() & np.isfinite(np.column_stack([residual, model, instruments])).all(axis=1)
        if moved and not usable.any():
            # No cell has slopes on both surfaces, as where the DEM has single cells only: the direction is not
            # determined.
            return _fitted(dem, reference, cells, None)
        usable &= np.abs(residual - np.median(residual[usable])) <= OUTLIERS * max(nmad(residual[usable]), 1e-6)
        solved = robust_fit(model[usable], instruments[usable], residual[usable], blocks_of(place[usable]))
        if not moved:
            break
        step_m = np.clip(solved.estimate[:2], -dem.grid.spacing_m, dem.grid.spacing_m)
        shift_m = np.clip(shift_m + step_m, -SEARCHED_M, SEARCHED_M)
        if np.abs(step_m).max() < 1e-3 * dem.grid.spacing_m:
            break
    left, sigma = residual - model @ solved.estimate, solved.sigma
    horizontal: dict[str, float] = {}
    if moved:
        names = ("east_m", "north_m", "east_sigma_m", "north_sigma_m")
        horizontal = dict(zip(names, map(float, [*shift_m, *sigma[:2]]), strict=True))
    up_m, tilt_east, tilt_north = map(float, solved.estimate[-3:])
    up_sigma_m, tilt_east_sigma, tilt_north_sigma = map(float, sigma[-3:])
    return Shift(
        up_m=up_m,
        up_sigma_m=up_sigma_m,
        tilt_east=tilt_east,
        tilt_north=tilt_north,
        tilt_east_sigma=tilt_east_sigma,
        tilt_north_sigma=tilt_north_sigma,
        rms_m=_rms((dem.height_m - reference.on(dem.grid).height_m)[cells]),
        shifted_rms_m=_rms(left[usable]),
        **horizontal,
    )


def _coarse_shift(
    dem: Raster, reference: ReferenceSurface, cells: Bool[np.ndarray, "row column"]
) -> Float[np.ndarray, "2"]:
    """Return the trial shift, of whole cells of one surface around the DEM, after which both differ least, by NMAD."""
    grid = dem.grid
    trials = np.unique(np.rint(SEARCHED_M / TRIALS / grid.spacing_m * np.arange(-TRIALS, TRIALS + 1)).astype(int))
    reach = int(trials[-1])
    around = reference.on(_widened(grid, reach)).height_m
    spreads = {}
    for east, north in product(trials, trials):
        moved = around[reach - north :, reach - east :][: grid.rows, : grid.columns]
        difference = (dem.height_m - moved)[cells]
        finite = difference[np.isfinite(difference)]
        if len(finite) > len(difference) / 2:
            spreads[east, north] = nmad(finite)
    best = min(spreads, key=lambda trial: (spreads[trial], np.hypot(*trial))) if spreads else (0, 0)
    return grid.spacing_m * np.array(best, dtype=float)


def _widened(grid: Grid, cells: int) -> Grid:
    """Return a grid with so many cells more to each side."""
    return replace(
        grid,
        west_m=grid.west_m - cells * grid.spacing_m,
        south_m=grid.south_m - cells * grid.spacing_m,
        columns=grid.columns + 2 * cells,
        rows=grid.rows + 2 * cells,
    )


def _trend_of(error_m: Float[np.ndarray, " n"], place_m: Float[np.ndarray, "n 2"], middle_m: np.ndarray) -> Shift:
    """Return the vertical shift of a DEM against checkpoints, and its tilt if there are enough."""
    model = np.ones((len(error_m), 1))
    if len(error_m) >= TILT_CHECKPOINTS:
        model = np.column_stack([model, place_m - middle_m])
    # Of few checkpoints each is far from the others, and a block of its own.
    block = blocks_of(place_m) if len(error_m) >= OFFSET_CHECKPOINTS * BLOCKS else np.arange(len(error_m))
    fit = robust_fit(model, model, error_m, block)
    solved, sigma, left = fit.estimate, fit.sigma, error_m - model @ fit.estimate
    tilt: dict[str, float] = {}
    if len(solved) == 3:
        names = ("tilt_east", "tilt_north", "tilt_east_sigma", "tilt_north_sigma")
        tilt = dict(zip(names, map(float, [*solved[1:], *sigma[1:]]), strict=True))
    return Shift(
        up_m=float(solved[0]), up_sigma_m=float(sigma[0]), rms_m=_rms(error_m), shifted_rms_m=_rms(left), **tilt
    )


def _middle_m(grid: Grid) -> Float[np.ndarray, "2"]:
    west, east, south, north = grid.extent_m
    return np.array([(west + east) / 2, (south + north) / 2])


def _rms(values: Float[np.ndarray, " n"]) -> float:
    """Return the RMS of values without outliers."""
    values = values[np.isfinite(values)]
    kept = values[np.abs(values - np.median(values)) <= OUTLIERS * max(nmad(values), 1e-6)] if len(values) else values
    return float(np.sqrt(np.mean(kept**2))) if len(kept) else float("nan")


# --------------------------------------------------------------------------------------------------------- reading
def read_reference(path: Path, grid: Grid, sigma_m: float = 0.0) -> ReferenceSurface | Checkpoints:
    """Return the measured heights of a file, on and around a grid; see `compare_with_reference`."""
    check_bounds([("reference-sigma", sigma_m, 0.0, 1e4)])
    read = {".las": _read_cloud, ".laz": _read_cloud, ".csv": _read_checkpoints, ".txt": _read_checkpoints}
    reference = read.get(path.suffix.lower(), _read_raster)(path, grid, sigma_m)
    if isinstance(reference, Checkpoints):
        inside = int(grid.cell_of(reference.place_m)[2].sum())
        if inside < OFFSET_CHECKPOINTS:
            raise InputFileError(
                f"{KEY} = {shown(path)}: {inside} of {len(reference.place_m)} places lie within the DEM, "
                f"{spans(_map_extent(grid))}; give at least {OFFSET_CHECKPOINTS}, x and y in its coordinates"
            )
    elif not reference.on(grid).filled.any():
        covered = spans(_extent_on(grid, reference))
        message = f"has no height within the DEM: it covers {covered}, and the DEM {spans(_map_extent(grid))}"
        raise InputFileError(f"{KEY} = {shown(path)}: {message}; give a reference that covers it")
    return reference


def _map_extent(grid: Grid) -> tuple[float, float, float, float]:
    """Return west, south, east and north of a grid in the coordinates of its map."""
    west, east, south, north = grid.extent_m
    x, y, _ = _origin_m(grid)
    return west + x, south + y, east + x, north + y


def _extent_on(grid: Grid, reference: "ReferenceSurface") -> tuple[float, float, float, float]:
    """Return west, south, east and north of measured heights in the coordinates of a grid's map."""
    rows, columns = reference.height_m.shape
    corner = np.array([*product((0.0, float(columns)), (0.0, float(rows)))])
    reference_crs, theirs = CRS.from_wkt(reference.crs), CRS.from_wkt(_crs_of(grid))
    x, y = convert(reference_crs, theirs, *apply_affine(reference.transform, *corner.T))
    return float(x.min()), float(y.min()), float(x.max()), float(y.max())


def _read_raster(path: Path, grid: Grid, sigma_m: float) -> ReferenceSurface:
    named = f"{KEY} = {shown(path)}"
    with open_raster(path, KEY) as file:
        require_cells(file, named, "heights")
        crs = _same_kind_of_crs(file.crs.to_wkt() if file.crs else None, grid, named)
        unit_m = height_system(file.units[0], CRS.from_wkt(crs), None, None).unit_m
        height = file.read(1, masked=True, out_dtype="float64").filled(np.nan) * unit_m
        return ReferenceSurface(
            kind="raster",
            height_m=height - _base_m(grid),
            transform=file.transform,
            crs=horizontal_crs(CRS.from_wkt(crs)).to_wkt(),
            sigma_m=sigma_m,
        )


def _read_cloud(path: Path, grid: Grid, sigma_m: float) -> ReferenceSurface | Checkpoints:
    """Return the mean heights of the first returns in the cells of a grid, with a margin for the shift.

    Where fewer than half of the cells within the cloud's bounds have a point, its points are checkpoints.
    """
    wide = _widened(grid, int(np.ceil(SEARCHED_M / grid.spacing_m)))
    with open_cloud(path, KEY) as cloud:
        crs = CRS.from_wkt(_same_kind_of_crs(cloud.crs_wkt, grid, cloud.name))
        east_m, north_m = _origin_m(grid)[:2]
        frame = MapFrame(crs=horizontal_crs(CRS.from_wkt(_crs_of(grid))), origin_m=(east_m, north_m))
        vertical = cloud_height_system(crs, key=KEY).unit_m

        def local_of(
            x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]
        ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
            return frame.local_of(horizontal_crs(crs), x, y)

        def pieces(dimension: str | None = None) -> Iterator[Piece]:
            return cloud.pieces("first", local_of, vertical, dimension)

        (west, south), (east, north) = np.reshape(cloud.extent_m(local_of), (2, 2))
        ours_west, ours_east, ours_south, ours_north = wide.extent_m
        if not (west < ours_east and east > ours_west and south < ours_north and north > ours_south):
            covered = spans((west + east_m, south + north_m, east + east_m, north + north_m))
            message = f"covers {covered}, and the DEM {spans(_map_extent(grid))}; give a reference that covers it"
            raise InputFileError(f"{cloud.name}: has no height within the DEM: it {message}")
        raster = gridded(pieces, wide, "mean", 0.5)
        cells = np.argwhere(raster.filled)
        if len(cells) < MIN_FILLED_FRACTION * np.prod(np.ptp(cells, axis=0) + 1 if len(cells) else 1):
            place_m, height_m = (np.concatenate(part) for part in zip(*pieces(), strict=True))
            own_m = np.full(len(height_m), sigma_m)
            height_m = height_m - _base_m(grid)
            return Checkpoints(place_m=place_m, height_m=height_m, sigma_m=own_m, kind="sparse cloud")
        cover = majority(pieces("classification"), wide, tuple(COVERS.values()))[::-1]
    return ReferenceSurface(
        kind="cloud",
        height_m=raster.height_m[::-1] - _base_m(grid),
        transform=Affine(*wide.transform),
        crs=_crs_of(grid),
        sigma_m=sigma_m,
        cover=np.where(cover < 0, np.nan, cover),
    )


def _read_checkpoints(path: Path, grid: Grid, sigma_m: float) -> Checkpoints:
    columns = {"x": None, "y": None, "z": None, "sigma": sigma_m}
    lines, table = read_numbers(path, f"{KEY} =", columns, REMEDY, further="ignored")
    rows = np.column_stack(table)
    if (negative := np.flatnonzero(rows[:, 3] < 0)).size:
        raise InputFileError(f"{KEY} = {shown(path)}: line {lines[negative[0]]} has a negative sigma; give 0 or more")
    if (empty := np.flatnonzero((rows[:, 2] == UNDECLARED_NODATA) | (np.abs(rows[:, 2]) > MAX_HEIGHT_M))).size:
        raise InputFileError(
            f"{KEY} = {shown(path)}: line {lines[empty[0]]} has z = {rows[empty[0], 2]:g}, not a height on Earth "
            f"({len(empty)} of {len(rows)} lines); leave such lines out"
        )
    position_m = rows[:, :3] - np.array(_origin_m(grid))
    return Checkpoints(place_m=position_m[:, :2], height_m=position_m[:, 2], sigma_m=rows[:, 3])


# Local metres have no CRS; rasterio asks for one, and the same for both leaves coordinates as they are.
LOCAL = CRS.from_epsg(3857).to_wkt()


def _crs_of(grid: Grid) -> str:
    place = grid.georeference
    return LOCAL if place is None else horizontal_crs(CRS.from_wkt(place.crs_wkt)).to_wkt()


def _origin_m(grid: Grid) -> tuple[float, float, float]:
    return (0.0, 0.0, 0.0) if grid.georeference is None else grid.georeference.origin_m


def _base_m(grid: Grid) -> float:
    return _origin_m(grid)[2]


def _same_kind_of_crs(wkt: str | None, grid: Grid, named: str) -> str:
    """Return the CRS of a file; InputFileError if only one of file and DEM has one."""
    if wkt is None and grid.georeference is not None:
        raise InputFileError(f"{named}: has no CRS, and the DEM has one; add it with gdal_translate -a_srs, or las2las")
    if wkt is not None and grid.georeference is None:
        message = f"{named}: has a CRS, and the DEM is in local metres; give a file in the same metres without a CRS"
        raise InputFileError(message)
    if wkt is None or grid.georeference is None:
        return LOCAL
    try:
        crs = CRS.from_wkt(wkt)
    except CRSError as error:
        raise InputFileError(f"{named}: its CRS cannot be used ({reason_of(error)}); {REMEDY}") from error
    dem_datum, other = vertical_datum(CRS.from_wkt(grid.georeference.crs_wkt)), vertical_datum(crs)
    if dem_datum and other and dem_datum != other:
        warning = "%s: heights count from %s, and those of the DEM from %s; convert them, or take the shift out"
        logger.warning(warning, named, other, dem_datum)
    return crs.to_wkt()
