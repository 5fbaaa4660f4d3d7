"""The whole chain, from a scenario to a DEM and its error."""

import logging
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, Inexact

from sionna_radar.accuracy.compare import DemError, difference, summarise
from sionna_radar.accuracy.edges import edge_cells, walls_on
from sionna_radar.accuracy.main_beam import main_beam_hits
from sionna_radar.accuracy.precipitation import from_rain
from sionna_radar.detection.detector import RESPONSE_CELLS
from sionna_radar.detection.echoes import Echoes
from sionna_radar.detection.profiles import Profiles
from sionna_radar.detection.volume.detector import ThroughVolume
from sionna_radar.flight.pulses import Navigation, Pulses, PulseSchedule
from sionna_radar.flight.scan import Scan
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.georeference import Georeference
from sionna_radar.foundation.linear_algebra import on_one_thread
from sionna_radar.foundation.progress import Progress, silent
from sionna_radar.foundation.raster import Raster
from sionna_radar.foundation.stopwatch import Stopwatch
from sionna_radar.mapping.beam import beam_nodes
from sionna_radar.mapping.coverage import Illumination
from sionna_radar.mapping.echo_model import Sightings
from sionna_radar.mapping.gridding import grid_points
from sionna_radar.mapping.points import Points, locate
from sionna_radar.mapping.surface_map import map_surface
from sionna_radar.radar.antenna import Antenna
from sionna_radar.scenario import Scenario
from sionna_radar.scene.raycast import truth_dem
from sionna_radar.survey.preparation import Preparation, prepare
from sionna_radar.survey.sensors import Observation, SawtoothRadar, Sensor, TriangularRadar, build_sensor, received
from sionna_radar.survey.warnings import Brief, replaced_parts, warnings_of
from sionna_radar.tracing.engine import Tracer
from sionna_radar.tracing.paths import VOLUME

logger = logging.getLogger("sionna_radar")

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
class Survey(Brief):
    """A finished survey, with the scenario that made it.

    pulses, paths: how many were simulated.
    dem, truth, error: rasters on one grid; error is DEM minus truth.
    lit: cells with a true height that the main beam reached.
    dem_error: of all cells that the DEM fills; lit_error: of those among them that the main beam reached.
    off_wall_error: of lit cells farther than half a footprint from any wall; None where there are no walls.
    chirp: the record of the chirp in the middle of the survey; None for a sensor without chirps.
    timing_s: seconds spent in each stage, and in all under `total`.
    replaced: what the caller gave in place of parts of the scenario, by their keys in it.
    warnings: what spoils the result.
    """

    scenario: Scenario
    schedule: PulseSchedule
    pulses: int
    paths: int
    points: Points
    dem: Raster
    truth: Raster
    error: Raster
    lit: Bool[np.ndarray, "row column"]
    dem_error: DemError
    lit_error: DemError
    off_wall_error: DemError | None
    georeference: Georeference | None
    chirp: ChirpRecord | None
    timing_s: dict[str, float]
    peak_memory_mb: float
    replaced: dict[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    def __repr__(self) -> str:
        lit, described = self.lit_error, self.scenario.description
        lines = [
            f"Survey: {described or 'no description'}",
            f"  {self.pulses:,} pulses, {len(self.points):,} echoes, DEM of {self.dem.grid.columns} x "
            f"{self.dem.grid.rows} cells of {self.dem.grid.spacing_m:g} m",
            f"  lit cells: RMS error {lit.rms_m:.3f} m, mean {lit.mean_m:+.3f} m, coverage {lit.coverage:.1%}"
            if lit.count
            else "  no cell of the DEM is filled where the main beam reached",
        ]
        lines += [f"  {key} replaced by {what}" for key, what in self.replaced.items()]
        return "\n".join(lines + [f"  warning: {warning}" for warning in self.warnings])


@on_one_thread
def run(
    scenario: Scenario,
    *,
    block_size: int = BLOCK_SIZE,
    antenna: Antenna | None = None,
    scan: Scan | None = None,
    navigation: Navigation | None = None,
    sensor: Callable[[Preparation], Sensor] | None = None,
    progress: Progress = silent,
) -> Survey:
    """Fly a survey and return its points, its DEM and its error.

    Parameters
    ----------
    scenario:
        The survey.
    block_size:
        Pulses simulated at once; it changes the speed and the memory, never the result.
    antenna, scan, navigation:
        A custom antenna, scan or navigation system in place of the scenario's.
    sensor:
        What builds a custom sensor from the prepared survey.
    progress:
        Called at the start of each stage and after each of its steps; see `Progress`.

    Raises
    ------
    ScenarioError, InputFileError
        The scenario cannot be flown; see `prepare`.

    """
    watch = Stopwatch()
    progress("preparing", 0, 0)
    with watch("prepare"):
        ready = prepare(scenario, antenna=antenna, scan=scan, navigation=navigation)
        carried = sensor(ready) if sensor else build_sensor(ready, watch)
    progress("preparing", 1, 1)
    recording = record(ready, carried, block_size=block_size, progress=progress, watch=watch)
    progress("mapping", 0, 0)
    with watch("map"):
        points = place(recording.echoes, carried, ready.schedule, block_size=block_size)
        dem = map_points(points, recording.profiles, ready)
    progress("mapping", 1, 1)
    with watch("compare"):
        truth = true_surface(ready)
        error = difference(dem, truth)
        lit = recording.lit & truth.filled
        walls = walls_on(ready.grid, ready.built.scene, ready.scenario.buildings)
        off_wall = lit & ~edge_cells(ready.grid, points, ready.antenna.beamwidths_rad[1], walls)
        chirp = None
        if isinstance(carried, SawtoothRadar | TriangularRadar):
            chirp = record_chirp(ready, carried.tracer, carried.through[0])
    warnings = warnings_of(
        len(recording.echoes),
        recording.rain_echoes,
        recording.lost_to_rain,
        len(ready.schedule),
        scenario.weather.falling or "air",
        None if ready.expected_ground is None else "processing.expected_ground",
        stepped_behind_volume=scenario.dem.method == "stepped" and recording.behind_volume,
    )
    for warning in warnings:
        logger.warning("%s", warning)
    return Survey(
        scenario=scenario,
        schedule=ready.schedule,
        pulses=len(ready.schedule),
        paths=recording.paths,
        points=points,
        dem=dem,
        truth=truth,
        error=error,
        lit=lit,
        dem_error=summarise(error, lit),
        lit_error=summarise(error.only(lit), lit),
        off_wall_error=summarise(error.only(off_wall), off_wall) if walls else None,
        georeference=ready.built.scene.georeference,
        chirp=chirp,
        timing_s=watch.seconds(),
        peak_memory_mb=peak_memory_mb(),
        replaced=replaced_parts(antenna, scan, navigation, sensor),
        warnings=warnings,
    )


@dataclass(frozen=True, kw_only=True)
class Recording:
    """What a sensor brings home from a survey; the measured pose has no part in it.

    echoes: sorted by pulse, not corrected for Doppler.
    profiles: range profiles around them, where the scenario's map models whole echoes; else None.
    lit: cells of the DEM that the beam reached.
    paths: how many were traced.
    rain_echoes: how many of the echoes hold more of rain than of anything else, where nothing is done about rain.
    lost_to_rain: pulses without an echo because rain in front of the ground leaves it too little.
    """

    echoes: Echoes
    profiles: Profiles | None
    lit: Bool[np.ndarray, "row column"]
    paths: int
    rain_echoes: int
    lost_to_rain: int = 0

    @property
    def behind_volume(self) -> bool:
        """Whether its profiles are of ground behind a volume of rain."""
        return self.profiles is not None and self.profiles.volume is not None


@on_one_thread
def record(
    ready: Preparation,
    sensor: Sensor,
    *,
    block_size: int = BLOCK_SIZE,
    progress: Progress = silent,
    watch: Stopwatch | None = None,
) -> Recording:
    """Fly a prepared survey and return what the sensor observed, block by block."""
    watch = watch or Stopwatch()
    illumination = Illumination(ready.grid)
    echoes, profiles, path_count, rain_count, lost_count = [], [], 0, 0, 0
    progress("tracing", 0, len(ready.schedule))
    for block in fly(ready, sensor, block_size):
        echoes.append(block.seen.echoes)
        if ready.scenario.dem.method != "linear" and block.seen.profiles is not None:
            profiles.append(block.seen.profiles)
        with watch("map"):
            illumination.add(*main_beam_hits(block.seen.paths, block.pulses, ready.antenna))
        path_count += len(block.seen.paths)
        if block.seen.through_volume:
            lost_count += len(block.pulses) - len(np.unique(block.seen.echoes.pulse))
        else:
            rain_count += _count_of_rain(block, sensor, ready)
        progress("tracing", int(block.pulses.index[-1]) + 1, len(ready.schedule))
    return Recording(
        echoes=Echoes.concatenate(echoes),
        profiles=Profiles.concatenate(profiles) if profiles else None,
        lit=illumination.mask(ready.max_gap_m, true_surface(ready), ready.built.caster.visible),
        paths=path_count,
        rain_echoes=rain_count,
        lost_to_rain=lost_count,
    )


def _count_of_rain(block: "Block", sensor: Sensor, ready: Preparation) -> int:
    if not np.any(block.seen.paths.surface == VOLUME):
        return 0
    echoes = sensor.correct(block.seen.echoes, block.pulses.index, block.pulses.measured)
    return int(from_rain(echoes, block.seen.paths, ready.chirp).sum())


@dataclass(frozen=True, kw_only=True)
class Block:
    """A block of pulses and what the sensor saw; its echoes are not corrected for Doppler."""

    pulses: Pulses
    seen: Observation


def fly(ready: Preparation, sensor: Sensor, block_size: int) -> Iterator[Block]:
    """Yield the survey block by block, as the sensor observes it."""
    for pulses in ready.schedule.line_blocks(block_size):
        yield Block(pulses=pulses, seen=sensor.observe(pulses))


def place(echoes: Echoes, sensor: Sensor, schedule: PulseSchedule, *, block_size: int = BLOCK_SIZE) -> Points:
    """Correct and locate echoes by the poses that a schedule's navigation reports."""
    located = []
    for pulses in schedule.blocks(block_size):
        own = echoes.of_pulses(pulses.index)
        corrected = sensor.correct(own, pulses.index, pulses.measured)
        located.append(locate(corrected, pulses.index, pulses.measured))
    return Points.concatenate(located)


def grid_dem(points: Points, ready: Preparation) -> Raster:
    """Return the DEM of located echoes on the survey's grid, linear between them."""
    shadow_rad = float(np.deg2rad(ready.scenario.dem.shadow_incidence_deg))
    return grid_points(points, ready.grid, ready.max_gap_m, shadow_rad)


@on_one_thread
def map_points(points: Points, profiles: Profiles | None, ready: Preparation) -> Raster:
    """Return the DEM by the method that the scenario asks for; "linear" alone needs no profiles.

    Raises ScenarioError where another method has none.
    """
    method = ready.scenario.dem.method
    if method == "linear":
        return grid_dem(points, ready)
    if profiles is None:
        message = f"{method!r} models whole echoes, and this sensor brings none; set dem.method = 'linear'"
        raise ScenarioError([Problem("dem.method", message)])
    return map_surface(method, points, sightings(profiles, ready), ready.grid, ready.max_gap_m)


def sightings(profiles: Profiles, ready: Preparation) -> Sightings:
    """Return range profiles with what a map may know of the radar: its measured pose, its sweep and its beam."""
    analyser = ready.detector.analyser
    return Sightings(
        profiles=profiles,
        pose=ready.schedule.pulses(profiles.pulse).measured,
        chirp=ready.chirp,
        beam=beam_nodes(ready.antenna),
        response=analyser.response(RESPONSE_CELLS, 1),
        looks_per_cell=analyser.looks_per_cell,
        doppler=1.0 if ready.scenario.processing.doppler_correction else 0.0,
        reach_m=ready.chirp.max_range_m,
    )


def true_surface(ready: Preparation) -> Raster:
    """Return the surface that a DEM is compared with."""
    return truth_dem(ready.built.caster, ready.grid, float(ready.built.scene.bounds_m[1, 2]) + 10.0)


def record_chirp(ready: Preparation, tracer: Tracer, through: ThroughVolume | None = None) -> ChirpRecord:
    """Return the chirp in the middle of the survey, of a triangle its rising half, with what is found in it.

    Behind rain the threshold is what rain and noise exceed at the false-alarm rate.
    """
    pulses = ready.schedule.pulses(np.array([len(ready.schedule) // 2]))
    beat = received(tracer.trace(pulses), pulses, ready)
    spectra = ready.detector.spectra(beat)
    if through is None:
        echoes = ready.detector.uncorrected(spectra, pulses.index, ready.window_m(pulses, ready.chirp))
    else:
        echoes = through.find(spectra.power, pulses, ready.chirp, ready.window_m(pulses, ready.chirp)).echoes
        spectra = replace(spectra, threshold=through.threshold(spectra))
    tested = np.isfinite(spectra.threshold[0])
    return ChirpRecord(
        pulse=int(pulses.index[0]),
        sample_time_s=ready.chirp.sample_time_s,
        beat=beat[0],
        range_m=ready.detector.analyser.range_m,
        power=spectra.power[0],
        threshold=np.where(tested, spectra.threshold[0], np.nan),
        echo_range_m=echoes.range_m,
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
