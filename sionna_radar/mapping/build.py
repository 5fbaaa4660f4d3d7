"""Builder of the mapper of a scenario: DEM method, land cover, and speckle decorrelation of its ground."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.flight.instrument import InstrumentErrors
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.raster import Grid
from sionna_radar.inference.echo.likelihood import LandCover
from sionna_radar.inference.echo.speckle import STILL, SpeckleMemory
from sionna_radar.mapping.mapper import MICRORELIEF_M, DemMethod, Mapper
from sionna_radar.mapping.obstacles import ObstacleRule
from sionna_radar.radar.antenna import Antenna
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.materials import SurfaceTable
from sionna_radar.scenario.parts import DEM_METHODS
from sionna_radar.scenario.processing import DemTable
from sionna_radar.scenario.registry import Builder, Facts, registers, require
from sionna_radar.scenario.table import Table
from sionna_radar.scene.terrains.build import cover_numbers
from sionna_radar.surfaces.build import build_materials
from sionna_radar.surfaces.motion import Windblown


@registers(DEM_METHODS, "[dem.method_parameters]")
def register_dem_method(name: str, parameters: type[Table] | None = None) -> Callable[[Builder], Builder]:
    """Register a DEM method, for `dem.method` in a scenario.

    It decorates a class or function that builds a `DemMethod`; it is called with the parameters, if any.

    Examples
    --------
    >>> import numpy as np
    >>> @register_dem_method("highest_point")
    ... class HighestPoint:
    ...     profiles = "unused"
    ...     def __call__(self, inputs):
    ...         height_m = np.full(inputs.grid.shape, np.nan)
    ...         row, column, inside = inputs.grid.cell_of(inputs.points.position_m)
    ...         np.fmax.at(height_m, (row[inside], column[inside]), inputs.points.position_m[inside, 2])
    ...         return Raster(grid=inputs.grid, height_m=height_m)
    >>> overrides = {"dem.method": "highest_point", "platform.length_m": 10.0}
    >>> run(load_scenario("hills", overrides)).lit_error.rms_m < 1.0
    True
    """

    def add(build: Builder) -> Builder:
        facts = Facts(profiles=getattr(build, "profiles", "unused"))
        return DEM_METHODS.register(name, parameters, facts)(build)

    return add


def build_dem_method(table: DemTable) -> DemMethod:
    """Return the DEM method of a scenario."""
    entry, parameters = DEM_METHODS.entry(table.map_method), table.method_parameters
    # Parameters of another method, kept by a copied table, are replaced by defaults.
    method_parameters = parameters if isinstance(parameters, entry.parameters or ()) else entry.check(None)
    method: DemMethod = entry(method_parameters)
    require(method, DemMethod, str(entry))
    return method


def build_mapper(
    dem: DemTable,
    grid: Grid,
    max_gap_m: float,
    antenna: Antenna | None,
    analyser: SpectrumAnalyser,
    doppler_corrected: bool,
    method: DemMethod | None = None,
    memory: SpeckleMemory | None = None,
    *,
    measured_ground: bool,
    errors: InstrumentErrors | None = None,
    ground: Scenario | None = None,
    obstacles: ObstacleRule | None = None,
) -> Mapper:
    """Return the mapper of a scenario.

    dem: the scenario's `[dem]`.
    grid, max_gap_m: cells of the DEM, and the largest distance of a filled one from a measured one.
    antenna, analyser, doppler_corrected: see `Mapper`.
    method: a custom method in place of the scenario's.
    memory: how long the ground keeps its speckle; without it, it stands still.
    measured_ground: whether the ground is real or from a file, with relief finer than the footprint unless `dem` says
        another one.
    errors: known ones of the instrument: those of its ranges; poses are without them.
    ground: the scenario whose covers `dem.cover` may know, in local metres; None if there is none.
    obstacles: see `Mapper`.

    Raises ScenarioError, InputFileError as `land_cover_of`.
    """
    microrelief_m = dem.microrelief_m
    if microrelief_m is None:
        microrelief_m = MICRORELIEF_M if measured_ground else 0.0
    return Mapper(
        method=method or build_dem_method(dem),
        name=type(method).__name__ if method else dem.method,
        grid=grid,
        max_gap_m=max_gap_m,
        shadow_incidence_rad=float(np.deg2rad(dem.shadow_incidence_deg)),
        antenna=antenna,
        analyser=analyser,
        doppler_corrected=doppler_corrected,
        memory=memory or STILL,
        microrelief_m=microrelief_m,
        min_confidence_m=dem.min_confidence_m,
        range_bias_m=0.0 if errors is None else errors.range_bias_m,
        range_scale=0.0 if errors is None else errors.range_scale,
        cover=None if dem.cover == "unknown" else land_cover_of(ground, grid),
        surface=dem.surface,
        obstacles=obstacles,
    )


# Cells of a known cover to the side of one of the DEM, and how far beyond its border beams see ground.
COVER_CELLS, COVER_BORDER_M = 2, 20.0


def land_cover_of(scenario: Scenario | None, grid: Grid) -> LandCover:
    """Return the covers of a scenario in local metres around a DEM, with their levels.

    Raises ScenarioError where nothing says what covers the ground, InputFileError for covers that cannot be read.
    """
    west, east, south, north = grid.extent_m
    beyond = west - COVER_BORDER_M, south - COVER_BORDER_M, east + COVER_BORDER_M, north + COVER_BORDER_M
    spacing_m = grid.spacing_m / COVER_CELLS
    corner_m = west + spacing_m / 2, south + spacing_m / 2
    fine = replace(Grid.covering(*beyond, spacing_m, corner_m), georeference=grid.georeference)
    names, number = ([], None) if scenario is None else cover_numbers(scenario.terrain, fine)
    if scenario is None or number is None or not names:
        message = "'known' needs terrain.cover, cover_raster, cover_vector or fields; add one, or set 'unknown'"
        raise ScenarioError([Problem("dem.cover", message)])
    cover_names, of_name = np.unique(names, return_inverse=True)
    materials = build_materials({name: scenario.all_materials[name] for name in cover_names}, scenario.radar)
    incidence_rad = np.deg2rad(np.arange(90.0))
    gamma = np.stack([materials[name].sigma0(incidence_rad) for name in cover_names]) / np.cos(incidence_rad)
    cover = of_name[number].astype(np.uint16)
    return LandCover(grid=fine, cover=cover, gamma=np.maximum(gamma, np.finfo(float).tiny))


def speckle_memory(scenario: Scenario) -> SpeckleMemory:
    """Return the speckle decorrelation of a scenario's ground; of several materials, that of `terrain.material`."""
    table = scenario.tracing
    if table.speckle == "per_pulse":
        return SpeckleMemory(decorrelation_s=0.0)
    return SpeckleMemory(decorrelation_s=table.decorrelation_time_s or np.inf, plants=_plants(scenario))


def _plants(scenario: Scenario) -> Windblown | None:
    table = scenario.all_materials.get(getattr(scenario.terrain, "material", "ground"))
    if not isinstance(table, SurfaceTable) or table.motion != "plants":
        return None
    return Windblown.of(math.hypot(*scenario.weather.wind_mps[:2]), scenario.radar.carrier_hz)
