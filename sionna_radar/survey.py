"""The whole chain, from a scenario to a DEM and its error."""

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Inexact

from sionna_radar.detection.detector import RESPONSE_CELLS, Found
from sionna_radar.detection.profiles import Profiles
from sionna_radar.flight.pulses import Pose, Pulses, PulseSchedule
from sionna_radar.flight.scan import Scan
from sionna_radar.mapping.beam import beam_nodes
from sionna_radar.mapping.compare import DemError, difference, summarise
from sionna_radar.mapping.coverage import Illumination, main_beam_hits
from sionna_radar.mapping.echo_model import Sightings
from sionna_radar.mapping.gridding import grid_points
from sionna_radar.mapping.points import Points, locate
from sionna_radar.mapping.surface_map import map_surface
from sionna_radar.preparation import SAMPLED_PULSES, Preparation, prepare
from sionna_radar.radar.antenna import Antenna
from sionna_radar.raster import Georeference, Raster
from sionna_radar.scenario.models import Scenario
from sionna_radar.scene.raycast import truth_dem
from sionna_radar.signal.beat import synthesise
from sionna_radar.signal.noise import add_noise
from sionna_radar.stopwatch import Stopwatch
from sionna_radar.tracing.engine import Engine, EngineInputs, Tracer, build_engine
from sionna_radar.tracing.paths import Paths

BLOCK_SIZE = 256


@dataclass(frozen=True, kw_only=True)
class ChirpRecord:
    """One chirp on its way through the processing, kept for a figure.

    beat: samples of the beat signal, sqrt(W); real or complex (I/Q).
    range_m: range axis of the spectrum, not corrected for Doppler.
    power: calibrated power spectrum; threshold: what a cell must exceed; NaN where none is tested.
    echo_range_m, echo_power: the echoes found, on the axis of the spectrum.
    """

    pulse: int
    sample_time_s: Float[np.ndarray, " sample"]
    beat: Inexact[np.ndarray, " sample"]
    range_m: Float[np.ndarray, " cell"]
    power: Float[np.ndarray, " cell"]
    threshold: Float[np.ndarray, " cell"]
    echo_range_m: Float[np.ndarray, " echo"]
    echo_power: Float[np.ndarray, " echo"]


@dataclass(frozen=True, kw_only=True)
class Survey:
    """A finished survey, with the scenario that made it.

    pulses, paths: how many were simulated.
    dem, truth, error: rasters on one grid; error is DEM minus truth.
    chirp: the record of the chirp in the middle of the survey.
    timing_s: seconds spent in each stage, and in all under `total`.
    """

    scenario: Scenario
    schedule: PulseSchedule
    pulses: int
    paths: int
    points: Points
    dem: Raster
    truth: Raster
    error: Raster
    dem_error: DemError
    georeference: Georeference | None
    chirp: ChirpRecord
    timing_s: dict[str, float]
    peak_memory_mb: float


def run(
    scenario: Scenario,
    *,
    block_size: int = BLOCK_SIZE,
    antenna: Antenna | None = None,
    scan: Scan | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Survey:
    """Fly a survey and return its points, its DEM and its error.

    Parameters
    ----------
    scenario:
        The survey.
    block_size:
        Pulses simulated at once; it changes the speed and the memory, never the result.
    antenna, scan:
        An antenna or a scan of one's own in place of the scenario's.
    progress:
        Called after each block with the pulses done and the pulses in all.

    Raises
    ------
    ScenarioError, InputFileError
        The scenario cannot be flown; see `prepare`.

    """
    watch = Stopwatch()
    with watch("prepare"):
        ready = prepare(scenario, antenna=antenna, scan=scan)
        tracer = build_tracer(ready)
        illumination = Illumination(ready.grid)
    located, kept, path_count = [], Kept(), 0
    for block in fly(ready, tracer, block_size, watch):
        with watch("map"):
            located.append(locate(block.found.echoes, block.pulses.index, block.pulses.measured))
            if scenario.dem.method != "linear":
                kept.add(block)
            illumination.add(*main_beam_hits(block.paths, block.pulses, ready.antenna))
        path_count += len(block.paths)
        progress(int(block.pulses.index[-1]) + 1, len(ready.schedule))
    with watch("map"):
        points = Points.concatenate(located)
        dem = map_points(points, kept, ready)
    with watch("compare"):
        truth = truth_dem(ready.built.caster, ready.grid, float(ready.built.scene.bounds_m[1, 2]) + 10.0)
        error = difference(dem, truth)
        lit = illumination.mask(ready.max_gap_m, truth, ready.built.caster.visible)
        dem_error = summarise(error, lit & truth.filled)
        chirp = record_chirp(tracer, ready)
    return Survey(
        scenario=scenario,
        schedule=ready.schedule,
        pulses=len(ready.schedule),
        paths=path_count,
        points=points,
        dem=dem,
        truth=truth,
        error=error,
        dem_error=dem_error,
        georeference=ready.built.scene.georeference,
        chirp=chirp,
        timing_s=watch.seconds(),
        peak_memory_mb=peak_memory_mb(),
    )


@dataclass(frozen=True, kw_only=True)
class Block:
    """A block of pulses on its way through the chain."""

    pulses: Pulses
    paths: Paths
    found: Found


class Kept:
    """The profiles and measured poses that a map of the whole echoes needs, gathered block by block."""

    def __init__(self) -> None:
        self._profiles: list[Profiles] = []
        self._poses: list[Pose] = []

    def add(self, block: Block) -> None:
        """Keep what a block brought."""
        profiles = block.found.profiles
        self._profiles.append(profiles)
        self._poses.append(block.pulses.measured.rows(np.searchsorted(block.pulses.index, profiles.pulse)))

    def sightings(self, ready: Preparation) -> Sightings:
        """Return all that was kept, with what the map knows of the radar."""
        analyser = ready.detector.analyser
        return Sightings(
            profiles=Profiles.concatenate(self._profiles),
            pose=Pose.concatenate(self._poses),
            chirp=ready.chirp,
            beam=beam_nodes(ready.antenna),
            response=analyser.response(RESPONSE_CELLS, 1),
            looks_per_cell=analyser.looks_per_cell,
            doppler=1.0 if ready.scenario.processing.doppler_correction else 0.0,
            reach_m=ready.chirp.max_range_m,
        )


def fly(ready: Preparation, tracer: Tracer, block_size: int, watch: Stopwatch | None = None) -> Iterator[Block]:
    """Yield the survey block by block: traced, synthesised, detected."""
    watch = watch or Stopwatch()
    for pulses in ready.schedule.blocks(block_size):
        with watch("trace"):
            paths = tracer.trace(pulses)
        with watch("synthesise"):
            beat = received(paths, pulses, ready)
        with watch("detect"):
            found = ready.detector.find(beat, pulses.index, pulses.measured)
        yield Block(pulses=pulses, paths=paths, found=found)


def grid_dem(points: Points, ready: Preparation) -> Raster:
    """Return the DEM of located echoes on the survey's grid, linear between them."""
    shadow = np.deg2rad(ready.scenario.dem.shadow_incidence_deg)
    return grid_points(points, ready.grid, ready.max_gap_m, shadow)


def map_points(points: Points, kept: Kept, ready: Preparation) -> Raster:
    """Return the DEM by the method that the scenario asks for; only "linear" needs nothing kept."""
    method = ready.scenario.dem.method
    if method == "linear":
        return grid_dem(points, ready)
    return map_surface(method, points, kept.sightings(ready), ready.grid, ready.max_gap_m)


def build_tracer(ready: Preparation) -> Tracer:
    """Return the tracer of a prepared survey."""
    return tracer_with(build_engine(ready.scenario.tracing, engine_inputs(ready)), ready)


def engine_inputs(ready: Preparation) -> EngineInputs:
    """Return what an engine is made from."""
    reach = ready.chirp.max_range_m
    position = ready.schedule.sample(SAMPLED_PULSES).true.position_m
    return EngineInputs(
        scene=ready.built.scene,
        antenna=ready.antenna,
        chirp=ready.chirp,
        seed=ready.scenario.seed,
        caster=ready.built.caster,
        region_m=np.array([position.min(axis=0) - reach, position.max(axis=0) + reach]),
    )


def tracer_with(engine: Engine, ready: Preparation) -> Tracer:
    """Return a tracer of a prepared survey with an engine of one's own."""
    return Tracer(engine, ready.built.scene, ready.antenna, ready.chirp, ready.built.caster)


def received(paths: Paths, pulses: Pulses, ready: Preparation) -> Inexact[np.ndarray, "pulse sample"]:
    """Return the beat signals of a block as the receiver samples them: scaled to the sent power, with noise."""
    beat = np.sqrt(ready.transmit_power_w) * synthesise(paths, pulses, ready.chirp)
    return add_noise(beat, ready.noise_power_w, ready.scenario.seed, pulses.index)


def record_chirp(tracer: Tracer, ready: Preparation) -> ChirpRecord:
    """Return the chirp in the middle of the survey with its spectrum, threshold and echoes."""
    pulses = ready.schedule.pulses(np.array([len(ready.schedule) // 2]))
    beat = received(tracer.trace(pulses), pulses, ready)
    spectra = ready.detector.spectra(beat)
    echoes = ready.detector.echoes(spectra, pulses.index, pulses.measured)
    shift = 0.0
    if ready.scenario.processing.doppler_correction:
        shift = float(ready.chirp.doppler_range_m(pulses.measured.boresight_range_rate_mps)[0])
    tested = np.isfinite(spectra.threshold[0])
    return ChirpRecord(
        pulse=int(pulses.index[0]),
        sample_time_s=ready.chirp.sample_time_s,
        beat=beat[0],
        range_m=ready.detector.analyser.range_m,
        power=spectra.power[0],
        threshold=np.where(tested, spectra.threshold[0], np.nan),
        echo_range_m=echoes.range_m + shift,
        echo_power=echoes.power,
    )


def peak_memory_mb() -> float:
    """Return the largest resident memory of this process so far; NaN where the system does not tell."""
    try:
        import resource
    except ImportError:
        return float("nan")
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6
