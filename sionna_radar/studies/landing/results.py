"""Reading the map of a folder of results, what it states of its errors, and the obstacles that it reports."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from pyproj import CRS

from sionna_radar.elevation.placed_raster import horizontal_crs
from sionna_radar.flight.frames import MIN_GRAZING_SINE
from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import read_text, regular_file, shown
from sionna_radar.foundation.raster import Raster
from sionna_radar.foundation.raster_file import open_raster
from sionna_radar.inference.echo.beam import beam_nodes
from sionna_radar.inference.terrain.covariance import Covariance
from sionna_radar.inference.terrain.heights import Heights
from sionna_radar.mapping.mapper import MICRORELIEF_M
from sionna_radar.radar.build import build_antenna
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.recorded import RecordedSettings, results_settings
from sionna_radar.scene.vector_file import read_points
from sionna_radar.studies.landing.correlation import Correlation, expected_ground, shortest_correlation
from sionna_radar.studies.landing.study import DRAWS, Ground, Landing, Limits, Obstacles, assess

REMEDY = "give a folder that `sionna-radar run`, `process` or `fuse` wrote, with a map"
FUSED, PRIOR = "fuse.json", "terrain_prior"
MIN_POINTS, MAX_POINTS_BYTES = 20, 4_000_000_000


def landing_sites(survey: str | Path, limits: Limits | None = None, *, draws: int = DRAWS, seed: int = 0) -> Landing:
    """Return the landing sites on the map of a survey, and the probability that each cell is fit.

    Parameters
    ----------
    survey:
        Folder of results of `run`, `process` or `fuse`.
    limits:
        What a place must be; see `Limits`.
    draws, seed:
        How often the errors of the map are drawn, and by which seed.

    Returns
    -------
    The probability raster, the best sites with their reasons, and the check against the truth where it is known.

    Raises
    ------
    InputFileError
        The folder holds no map, or damaged files, or obstacles of another CRS.
    ScenarioError
        Limits or draws that are not positive; a footprint that the map does not hold or resolve.

    Examples
    --------
    >>> from pathlib import Path
    >>> survey = run(load_scenario("hills", {"platform.length_m": 10.0, "dem.method": "smooth"}))
    >>> files = write_survey(survey, Path("results"))
    >>> landing_sites("results", draws=100).sites[0].probability > 0.9
    True
    """
    limits = limits or Limits()
    return assess(read_ground(Path(survey).expanduser(), limits), limits, draws=draws, seed=seed)


def read_ground(folder: Path, limits: Limits) -> Ground:
    """Return the map of a folder of results as expected ground, with obstacles and truth where they are there.

    Raises InputFileError for a folder without a map or with damaged files, ScenarioError as `Limits.check`.
    """
    if not (folder / "dem.tif").is_file() or not (folder / "dem_sigma.tif").is_file():
        raise InputFileError(f"survey = {shown(folder)} holds no dem.tif with its dem_sigma.tif; {REMEDY}")
    with open_raster(folder / "dem.tif", "raster") as file:
        crs = file.crs.to_wkt() if file.crs else ""
    dem = Raster.read(folder / "dem.tif")
    limits.check(dem.grid)
    sigma_m = _on(folder / "dem_sigma.tif", dem)
    if not (sigma_m[dem.filled & np.isfinite(sigma_m)] > 0).all():
        message = "dem_sigma.tif holds standard deviations that are zero or negative, which no measured height has"
        raise InputFileError(f"survey = {shown(folder)}: {message}; {REMEDY}")
    other_side = step_m = None
    if (folder / "dem_other_side.tif").is_file():
        other_side, sigma_step_m = _on(folder / "dem_other_side.tif", dem), _on(folder / "dem_sigma_step.tif", dem)
        step_m = sigma_step_m / np.sqrt(np.maximum(other_side, 1e-12))
        sigma_m = np.sqrt(np.maximum(sigma_m**2 - sigma_step_m**2, 0.0))
    height_m = dem.height_m.astype(float)
    if not (dem.filled & np.isfinite(sigma_m)).any():
        raise InputFileError(f"survey = {shown(folder)} has a map without heights; {REMEDY}")
    if (folder / FUSED).is_file():
        correlation = shortest_correlation(_fused_prior(folder / FUSED), sigma_m)
    else:
        height_m, sigma_m, correlation = _expected(folder, height_m, sigma_m, dem.grid.spacing_m)
    truth = folder / "truth.tif"
    return Ground(
        name=folder.name,
        dem=Raster(grid=dem.grid, height_m=height_m),
        sigma_m=sigma_m,
        correlation=correlation,
        crs_wkt=crs,
        other_side=other_side,
        step_m=step_m,
        obstacles=_obstacles(folder / "obstacles.gpkg", crs),
        truth=Raster(grid=dem.grid, height_m=_on(truth, dem)) if truth.is_file() else None,
    )


def _expected(
    folder: Path, height_m: Float[np.ndarray, "row column"], sigma_m: Float[np.ndarray, "row column"], spacing_m: float
) -> tuple[Float[np.ndarray, "row column"], Float[np.ndarray, "row column"], Correlation]:
    """Return expected heights, their standard deviations and the correlation of their errors; see `expected_ground`."""
    settings = results_settings(folder, REMEDY)
    heights = _heights(folder / "points.csv", settings)
    places = len(np.unique(heights.place_m, axis=0))
    if places < MIN_POINTS:
        raise InputFileError(f"survey = {shown(folder)} has a map of echoes from {places} places, too few; {REMEDY}")
    microrelief_m = settings.dem.microrelief_m
    if microrelief_m is None:
        measured = not isinstance(settings, Scenario) or settings.measured_ground
        microrelief_m = MICRORELIEF_M if measured else 0.0
    return expected_ground(height_m, sigma_m, spacing_m, heights, settings.dem.map_method, microrelief_m)


def _fused_prior(path: Path) -> Covariance:
    try:
        prior = {name: float(value) for name, value in json.loads(read_text(path, "fusion =", REMEDY))[PRIOR].items()}
        if not (all(0 < prior[name] < np.inf for name in ("smoothness", "length_m", "variance_m2"))):
            raise ValueError("no positive numbers")
        return Covariance(**prior)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        message = f"fusion = {shown(path)} holds no {PRIOR} ({error!r:.80}); fuse the sources again"
        raise InputFileError(message) from error


def _on(path: Path, dem: Raster) -> Float[np.ndarray, "row column"]:
    """Return the values of a raster with the cells of the DEM; raises InputFileError for others."""
    raster = Raster.read(path)
    if raster.grid != dem.grid:
        raise InputFileError(f"raster = {shown(path)} has other cells than the DEM; {REMEDY}")
    return raster.height_m.astype(float)


def _heights(path: Path, settings: Scenario | RecordedSettings) -> Heights:
    """Return the echoes of a table of points as heights over round footprints."""
    remedy = "run the survey again with `--points csv`"
    radar = getattr(settings, "sensor", "radar") == "radar"
    spread = float(np.mean(beam_nodes(build_antenna(settings.radar.antenna)).spread)) if radar else 0.0
    regular_file(path, "points =", remedy, MAX_POINTS_BYTES)
    try:
        with path.open(encoding="utf-8") as file:
            names, *lines = file.read().splitlines()
        column = dict(zip(names.split(","), np.loadtxt(lines, delimiter=",", ndmin=2).T, strict=True)) if lines else {}
        axes = ("easting_m", "northing_m", "height_m") if "easting_m" in column else ("east_m", "north_m", "up_m")
        place = np.column_stack([column[axis] for axis in axes])
        away = place - np.column_stack([column[f"radar_{axis}"] for axis in axes])
        range_m = np.maximum(np.linalg.norm(away, axis=1), 1e-9)
        steep = np.clip(np.abs(away[:, 2]) / range_m, MIN_GRAZING_SINE, 1.0)
        sigma_m = np.hypot(column["range_sigma_m"] * steep, column.get("across_sigma_m", 0.0) * np.sqrt(1 - steep**2))
        if not (np.isfinite(place).all() and np.isfinite(sigma_m).all()):
            raise ValueError("numbers that are not finite")
    except (ValueError, KeyError) as error:
        raise InputFileError(f"points = {shown(path)} is no table of points ({error!r:.80}); {remedy}") from error
    flat = Heights.at_places(place[:, :2] - place[:, :2].mean(axis=0), place[:, 2], sigma_m)
    axis_m = range_m * spread / np.sqrt(steep)
    return replace(flat, footprint_m=axis_m[:, None, None] * np.eye(2))


ATTRIBUTES = ("top_m", "sigma_m", "radius_m", "probability")


def _obstacles(path: Path, crs_wkt: str) -> Obstacles | None:
    """Return the obstacles that a survey reports; None without a file of them."""
    if not path.exists() and not path.is_symlink():
        return None
    points = read_points(path, "obstacles", ATTRIBUTES, "obstacles")
    named, flat = f"obstacles = {shown(path)}", [CRS.from_wkt(crs_wkt) if crs_wkt else None, points.crs]
    # GeoPackages of local metres may name an engineering CRS.
    flat = [None if crs is None or crs.is_engineering else horizontal_crs(crs) for crs in flat]
    names = ["local metres" if crs is None else crs.name for crs in flat]
    if flat[0] is not flat[1] and not (flat[0] and flat[1] and flat[0].equals(flat[1], ignore_axis_order=True)):
        raise InputFileError(f"{named} is in {names[1]}, the map in {names[0]}; detect the obstacles again")
    values: dict[str, Any] = {name: np.asarray(points.values[name], dtype=float) for name in ATTRIBUTES}
    numbers, chance = np.column_stack([points.place_m, *values.values()]), values["probability"]
    possible = np.isfinite(numbers) & (numbers[:, 3:].min(axis=1, keepdims=True) >= 0) & (chance[:, None] <= 1)
    if not possible.all():
        raise InputFileError(f"{named} holds values that no obstacle has; detect the obstacles again")
    return Obstacles(place_m=points.place_m, **values)
