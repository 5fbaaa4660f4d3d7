"""Comparison of a DEM with measured heights, after their shift is estimated, and on demand taken out."""

import logging
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool

from sionna_radar.accuracy.breakdown import Breakdown, break_down
from sionna_radar.accuracy.compare import DemError, statistics
from sionna_radar.accuracy.coregistration import MIN_CELLS, OUTLIERS, Shift, middle_m, shift_between, trend_of
from sionna_radar.accuracy.illumination import Walls
from sionna_radar.accuracy.reference import KEY, OFFSET_CHECKPOINTS, Checkpoints, ReferenceSurface, read_reference
from sionna_radar.accuracy.uncertainty import Calibration, UncertaintyCheck, calibration, check_uncertainty
from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import shown
from sionna_radar.foundation.raster import Raster
from sionna_radar.inference.terrain.uncertainty import Uncertainty
from sionna_radar.mapping.points import Points

logger = logging.getLogger("sionna_radar")


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
        trend = shift.trend_m(dem.grid.centres_m, middle_m(dem.grid)).reshape(dem.grid.shape)
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
    height_m = dem.at(reference.place_m)
    inside = np.isfinite(height_m)
    error_m = (height_m - reference.height_m)[inside]
    if len(error_m) < OFFSET_CHECKPOINTS:
        raise InputFileError(
            f"{KEY} = {name}: {len(error_m)} of {len(inside)} places lie on filled cells of the DEM; "
            f"give at least {OFFSET_CHECKPOINTS}"
        )
    place_m, own_m = reference.place_m[inside], reference.sigma_m[inside]
    shift = trend_of(error_m, place_m, middle_m(dem.grid))
    _warn_of(shift, name, apply_shift)
    if apply_shift:
        error_m = error_m - shift.trend_m(place_m, middle_m(dem.grid))
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


def _shift_of(dem: Raster, reference: ReferenceSurface, cells: Bool[np.ndarray, "row column"], path: Path) -> Shift:
    """Return the shift of a DEM against the surface of a file; InputFileError with too few common cells."""
    common_cells = int((cells & reference.on(dem.grid).filled).sum())
    if common_cells < MIN_CELLS:
        message = (
            f"{KEY} = {shown(path)}: has {common_cells} heights where the DEM has any; give a reference that covers it"
        )
        raise InputFileError(message)
    return shift_between(dem, reference, cells)
