"""Builder of the tracer of a scenario: engine by name, weather, vegetation, mirrors and targets."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.constants import speed_of_light

from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scenario.objects import TargetMesh
from sionna_radar.scenario.parts import ENGINES
from sionna_radar.scenario.registry import Builder, registers
from sionna_radar.scenario.table import Table
from sionna_radar.scenario.tracing import TracingTable
from sionna_radar.scenario.weather import WeatherTable
from sionna_radar.scene.build import build_body
from sionna_radar.scene.model import Scene
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.surfaces.motion import Windblown
from sionna_radar.tracing.effects.atmosphere import Atmosphere
from sionna_radar.tracing.effects.bodies import rcs_m2
from sionna_radar.tracing.effects.canopy import Canopy
from sionna_radar.tracing.effects.physical_optics import Scatterer
from sionna_radar.tracing.engines.persistent.density import DensityMap, filled_beam, footprint_density
from sionna_radar.tracing.paths import Engine, SampledBeams, SteerableEngine
from sionna_radar.tracing.tracer import SteeredTracer, Tracer, build_moving_ground
from sionna_radar.weather.conditions import Weather
from sionna_radar.weather.gases import Air
from sionna_radar.weather.rain import CombinedRain, RainCell, RainField, RainMap


@dataclass(frozen=True, kw_only=True)
class EngineInputs:
    """Inputs of an engine.

    tracing: the scenario's `[tracing]`.
    caster: rays against the scene's surfaces, for engines that do not trace fields themselves.
    region_m: lowest and highest corner of the box that the survey can see.
    looks: beams of pulses spread over the survey, for what depends on how the scene is looked at.
    beams: the antenna steered to each beam of an electronic scan, by number; for a `SteerableEngine`.
    """

    tracing: TracingTable
    scene: Scene
    antenna: Antenna
    chirp: Chirp
    seed: int
    caster: RayCaster
    region_m: Float[np.ndarray, "2 3"]
    looks: SampledBeams
    beams: tuple[Antenna, ...] = ()


def sionna_engine(inputs: EngineInputs) -> Engine:
    """Return Sionna RT's fields inside the beam, with speckle that is new in each pulse or persists on the surface."""
    table = inputs.tracing
    if table.speckle == "persistent":
        from sionna_radar.tracing.engines.persistent.persistent import PersistentEngine

        rays = max(1, round(table.paths * table.side_lobe_share))
        return PersistentEngine(
            inputs.scene,
            inputs.antenna,
            inputs.chirp,
            inputs.seed,
            table.scatterers_per_m2 or _density(inputs, table.paths - rays),
            inputs.region_m,
            outer_rays=rays,
            decorrelation_time_s=table.decorrelation_time_s,
            caster=inputs.caster,
            bounces=table.bounces,
        )
    from sionna_radar.tracing.engines.beam.beam import BeamEngine

    return BeamEngine(
        inputs.scene,
        inputs.antenna,
        inputs.chirp,
        inputs.seed,
        table.paths,
        table.side_lobe_share,
        inputs.caster,
        table.bounces,
    )


def planned_density(inputs: EngineInputs) -> DensityMap | None:
    """Return the density of scatterers that the footprints of a flight ask for, none beside them; None without any."""
    table = inputs.tracing
    if table.engine != "sionna" or table.speckle != "persistent" or table.scatterers_per_m2:
        return None
    return _density(inputs, table.paths - max(1, round(table.paths * table.side_lobe_share)))


def _density(inputs: EngineInputs, scatterers: int) -> DensityMap:
    beams = [filled_beam(antenna) for antenna in inputs.beams or (inputs.antenna,)]
    looks = inputs.looks if inputs.beams else replace(inputs.looks, beam=np.zeros(len(inputs.looks), dtype=np.int64))
    return footprint_density(looks, beams, inputs.chirp.range_resolution_m, scatterers)


def gamma_engine(inputs: EngineInputs) -> Engine:
    """Return the paper's facet model, which is independent of Sionna."""
    from sionna_radar.tracing.engines.gamma.facets import GammaEngine

    return GammaEngine(
        inputs.scene,
        inputs.antenna,
        inputs.chirp,
        inputs.seed,
        inputs.caster,
        speckle=inputs.tracing.speckle,
        decorrelation_time_s=inputs.tracing.decorrelation_time_s,
    )


def stock_engine(inputs: EngineInputs) -> Engine:
    """Return Sionna's stock path solver, for checks."""
    from sionna_radar.tracing.engines.stock import PathSolverEngine

    return PathSolverEngine(inputs.scene, inputs.antenna, inputs.chirp, inputs.seed, samples=inputs.tracing.paths)


@registers(ENGINES, "[tracing.engine_parameters]")
def register_engine(name: str, parameters: type[Table] | None = None) -> Callable[[Builder], Builder]:
    """Register a tracing engine, for `tracing.engine` in a scenario.

    It decorates a class or function that builds an `Engine`; it is called with the parameters, if any, and with
    `EngineInputs`.

    Examples
    --------
    >>> import numpy as np
    >>> from sionna_radar.tracing import Paths
    >>> @register_engine("one_ray")
    ... class OneRay:
    ...     def __init__(self, inputs):
    ...         self.caster = inputs.caster
    ...     def trace(self, pulses):
    ...         hits = self.caster.cast(pulses.true.position_m, pulses.true.boresight)
    ...         row = np.flatnonzero(hits.hit)
    ...         return Paths.along_boresight(
    ...             pulses, row, hits.distance_m[row], gain=np.full(len(row), 1e-6 + 0j),
    ...             incidence_rad=np.arccos(hits.cosine[row]), surface=hits.surface[row],
    ...         )
    >>> overrides = {"tracing.engine": "one_ray", "platform.length_m": 10.0}
    >>> run(load_scenario("hills", overrides)).paths
    100
    """
    return ENGINES.register(name, parameters)


def build_engine(table: TracingTable, inputs: EngineInputs) -> Engine:
    """Return the engine named in a scenario; PluginError for a custom one that cannot be built."""
    return ENGINES.build(table.engine, Engine, table.engine_parameters, inputs)


def build_tracer(engine: Engine, inputs: EngineInputs, weather: WeatherTable) -> Tracer:
    """Return a tracer of surfaces, by an engine, and of targets, mirrors, vegetation and weather."""
    plants = inputs.scene.vegetation
    wind = Windblown.of(math.hypot(*weather.wind_mps[:2]), inputs.chirp.carrier_hz)
    return Tracer(
        engine,
        inputs.scene,
        inputs.antenna,
        inputs.chirp,
        inputs.caster,
        moving=build_moving_ground(inputs.scene, np.array(weather.wind_mps), inputs.chirp, inputs.seed),
        canopy=None if plants is None else Canopy(plants, inputs.scene, inputs.chirp, inputs.seed, wind),
        atmosphere=build_atmosphere(weather, inputs.antenna, inputs.chirp, inputs.seed),
        seed=inputs.seed,
        bounces=inputs.tracing.bounces,
    )


def build_steered_tracer(engine: Engine, inputs: EngineInputs, weather: WeatherTable) -> SteeredTracer:
    """Return the tracer of all beams, with engines that share the scene.

    Raises ScenarioError for an engine that cannot change its antenna.
    """
    if not isinstance(engine, SteerableEngine):
        message = f"{type(engine).__name__} has no method with_antenna, which an electronic scan needs; set 'sionna'"
        raise ScenarioError.of("tracing.engine", message)
    single_beams = [replace(inputs, antenna=beam, beams=()) for beam in inputs.beams]
    return SteeredTracer([build_tracer(engine.with_antenna(beam.antenna), beam, weather) for beam in single_beams])


def build_atmosphere(table: WeatherTable, antenna: Antenna, chirp: Chirp, seed: int) -> Atmosphere:
    """Return the weather of a scenario as seen by its radar."""
    return Atmosphere(build_weather(table, chirp.carrier_hz), antenna, chirp, seed)


def build_weather(table: WeatherTable, carrier_hz: float) -> Weather:
    """Return the weather of a scenario at a carrier.

    Parameters
    ----------
    table:
        Table `[weather]`.
    carrier_hz:
        Carrier of the radar, Hz.

    Returns
    -------
    The weather at the carrier.
    """
    air = Air(
        dry_pressure_pa=100 * table.dry_pressure_hpa,
        temperature_k=table.temperature_k,
        vapour_density_g_per_m3=table.vapour_g_per_m3,
    )
    return table.to(
        Weather,
        carrier_hz=carrier_hz,
        rain_map=rain_map_of(table),
        snowfall_mm_per_h=table.snow_mm_per_h,
        liquid_water_g_per_m3=table.water_in_air_g_per_m3,
        air=air if table.gases else None,
        wet_radome_m=None if table.wet_radome is None else table.wet_radome.radius_m,
    )


def rain_map_of(table: WeatherTable) -> RainMap | None:
    """Return the rain map of a scenario; None if its rain is uniform.

    Parameters
    ----------
    table:
        Table `[weather]`.

    Returns
    -------
    Rain rates by position; None if the rain is uniform.
    """
    parts: list[RainMap] = []
    field, cell = table.rain_field, table.rain_cell
    uneven = field is not None and field.spread_db > 0 and table.rain_rate_mm_per_h > 0
    if field is not None and uneven:
        parts.append(field.to(RainField, mean_mm_per_h=table.rain_rate_mm_per_h))
    if cell is not None and cell.peak_mm_per_h > 0:
        parts.append(cell.to(RainCell))
    if not parts:
        return None
    return CombinedRain(maps=tuple(parts), everywhere_mm_per_h=0.0 if uneven else table.rain_rate_mm_per_h)


def rcs_of_mesh(
    mesh: TargetMesh,
    carrier_hz: float,
    azimuth_rad: Float[np.ndarray, " azimuth"],
    elevation_rad: Float[np.ndarray, " elevation"],
    range_m: float = 1000.0,
) -> Float[np.ndarray, "elevation azimuth"]:
    """Return the cross-section of a shape from all sides, in square metres, by physical optics.

    Where it sees itself, up to three reflections between its faces add to it, of a wave polarized in the plane of its
    upward axis.

    Parameters
    ----------
    mesh:
        Its file, as in `[[targets]]`.
    carrier_hz:
        Of the radar.
    azimuth_rad, elevation_rad:
        Direction from which it is seen: clockwise from its front, and above its horizon.
    range_m:
        From which it is seen.

    Returns
    -------
    Radar cross-section in m², one row for each elevation and one column for each azimuth.

    Raises
    ------
    InputFileError, ScenarioError
        The file cannot be used, or is too large for the wavelength; the carrier or the range is no positive number.

    Examples
    --------
    >>> import numpy as np
    >>> import trimesh
    >>> from sionna_radar.scenario import TargetMesh
    >>> _ = trimesh.creation.icosphere(subdivisions=6, radius=0.05).export("ball.ply")
    >>> rcs_m2 = rcs_of_mesh(TargetMesh(path="ball.ply"), 77e9, np.zeros(1), np.zeros(1))
    >>> bool(abs(10 * np.log10(rcs_m2[0, 0] / (np.pi * 0.05**2))) < 1)
    True
    """
    for name, value in {"carrier_hz": carrier_hz, "range_m": range_m}.items():
        if not 0 < value < np.inf:
            raise ScenarioError.of(name, f"{value:g} is not positive and finite; give it in SI units")
    wavelength_m = speed_of_light / carrier_hz
    seen = Scatterer(build_body(mesh, "mesh", wavelength_m), wavelength_m)
    elevation, azimuth = np.meshgrid(elevation_rad, azimuth_rad, indexing="ij")
    level = np.cos(elevation)
    toward = np.stack([level * np.sin(azimuth), level * np.cos(azimuth), np.sin(elevation)], axis=-1)
    return rcs_m2(seen, toward.reshape(-1, 3), range_m).reshape(azimuth.shape)
