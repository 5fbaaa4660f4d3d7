"""The whole chain, from a scenario to a DEM and its error: this file is its table of contents."""

import logging
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sionna_radar.accuracy.compare import DemError
from sionna_radar.detection.ranging.estimator import RangeEstimator
from sionna_radar.flight.pulses import Navigation
from sionna_radar.flight.scan import Scan
from sionna_radar.foundation.checkpoints import Checkpoints
from sionna_radar.foundation.errors import Problem, ScenarioError, named_after
from sionna_radar.foundation.numerics import on_one_thread, to_db
from sionna_radar.foundation.progress import (
    Progress,
    Stopwatch,
    default_progress,
    let_rest,
    peak_memory_mb,
    release_memory,
)
from sionna_radar.foundation.workers import Workers
from sionna_radar.mapping.mapper import DemMethod, Estimate
from sionna_radar.mapping.points import Points
from sionna_radar.radar.antenna import Antenna
from sionna_radar.raytracer.backend import release_arrays
from sionna_radar.scenario import Scenario
from sionna_radar.signal.converter import rounding_over_noise
from sionna_radar.surfaces.backscatter import Backscatter
from sionna_radar.survey.navigation_sigma import navigation_sigma
from sionna_radar.survey.preparation import CustomParts, GivenTerrain, Prepared, prepare
from sionna_radar.survey.recording import BLOCK_SIZE, Recorder, Recording, SampleType, place
from sionna_radar.survey.remapping import map_with
from sionna_radar.survey.result import Saturation, Survey
from sionna_radar.survey.sensors.sensor import Sensor, SensorInputs
from sionna_radar.survey.shared_flight import record_with
from sionna_radar.survey.warnings import (
    burst_warnings,
    direction_warnings,
    idle_receiver_warnings,
    map_warnings,
    saturation_warnings,
    sight_warnings,
    steered_warnings,
    unexplained_warnings,
    warnings_of,
)
from sionna_radar.tracing.engine import Engine, EngineInputs

logger = logging.getLogger("sionna_radar")
# Keys that raise echoes, by the sensor.
LOUDER = {
    "radar": "radar.snr_db or radar.transmit_power_dbm",
    "lidar": "lidar.clear_range_m, lidar.ground_reflectivity or lidar.reflectivities",
}
# A map of more takes as much memory as the flight: what that leaves free goes back first, in hundredths of a second.
MANY_ECHOES = 50_000
# Spread over the survey, by which warnings know how the antenna looks at the ground.
WARNED_PULSES = 200


def run(
    scenario: Scenario | Prepared,
    *,
    block_size: int = BLOCK_SIZE,
    antenna: Antenna | None = None,
    scan: Scan | None = None,
    navigation: Navigation | None = None,
    terrain: GivenTerrain | None = None,
    materials: Mapping[str, Backscatter] | None = None,
    engine: Callable[[EngineInputs], Engine] | None = None,
    sensor: Callable[[SensorInputs], Sensor] | None = None,
    range_estimator: RangeEstimator | None = None,
    dem_method: DemMethod | None = None,
    recordings: Mapping[str, str | Path] | None = None,
    sample_type: SampleType = "float64",
    parts: Checkpoints | None = None,
    workers: Workers | None = None,
    progress: Progress | None = None,
) -> Survey:
    """Fly a survey and return its points, its DEM and its error.

    Parameters
    ----------
    scenario:
        The survey, or one that `prepare` has made ready; that one has its custom parts already.
    block_size:
        Pulses simulated at once; it changes the speed and the memory, never the result.
    antenna, scan, navigation, range_estimator, dem_method:
        Custom parts in place of the scenario's.
    terrain:
        Ground in place of the scenario's, with its material and covers: an array of heights with its spacing,
        `(height_m, spacing_m)`, rows from south to north, centred on the local origin (`Raster.from_array`); a `Raster`
        in local metres; the path of an elevation file, as `terrain.path`; or what builds a landscape.
    engine, sensor:
        What builds a custom tracing engine or sensor from what that is built from.
    materials:
        Models of backscatter by the names that the scenario's surfaces use.
    recordings:
        Files that the survey is recorded in while it flies, netCDF, by what they hold: "signals" (the beat signals, for
        `process`), "paths" or "profiles".
    sample_type:
        How recorded samples of beat signals are kept; those of "float64" give the same result again, bit for bit.
    parts:
        Where finished stretches of the flight and tiles of the map are kept as they come, and those that are there
        already are taken from; see `foundation.checkpoints`. A survey that is recorded is flown as a whole.
    workers:
        What flies the stretches and makes the tiles, from `open_workers`; without it this process. It never changes the
        result, and has no custom parts. A survey that is recorded is flown by this process.
    progress:
        Called at the start of each stage and after each of its steps; see `Progress`. Without it a notebook shows a
        bar, and a script nothing.

    Returns
    -------
    The survey; `repr` shows its error in a line.

    Raises
    ------
    ScenarioError, InputFileError
        The scenario cannot be flown; see `prepare`.
    OutputError
        A recording exists already, or cannot be written.
    PluginError
        A custom part lacks a method, or there are some for workers.
    WorkerError
        The workers are gone, or have another version of the program.

    Examples
    --------
    >>> survey = run(load_scenario("hills", {"platform.length_m": 10.0}))
    >>> survey.pulses, survey.warnings
    (100, ())

    """
    custom = CustomParts(
        antenna=antenna,
        scan=scan,
        navigation=navigation,
        terrain=terrain,
        materials=materials or {},
        engine=engine,
        sensor=sensor,
        range_estimator=range_estimator,
        dem_method=dem_method,
    )
    if isinstance(scenario, Prepared) and custom != CustomParts():
        message = "a prepared survey has its parts already; give them to `prepare`"
        raise TypeError(message)
    if block_size < 1:
        raise ScenarioError([Problem("block_size", f"{block_size} pulses are none; give at least 1")])
    source = (scenario.scenario if isinstance(scenario, Prepared) else scenario).source
    with named_after(source), default_progress(progress) as shown:
        return _run(scenario, custom, block_size, _Recordings.of(recordings, sample_type), parts, workers, shown)


@dataclass(frozen=True)
class _Recordings:
    """Files of recordings by their kinds; what writes them is loaded if there are any."""

    files: Mapping[str, Path]
    sample_type: SampleType

    @staticmethod
    def of(files: Mapping[str, str | Path] | None, sample_type: SampleType) -> "_Recordings":
        """Return the recordings that a caller asks for, and refuse those that cannot be."""
        if not files:
            return _Recordings({}, sample_type)
        from sionna_radar.survey.recordings.recorder import checked_files

        return _Recordings(checked_files({kind: Path(path) for kind, path in files.items()}), sample_type)

    def recorders(self, prepared: Prepared) -> AbstractContextManager[Sequence[Recorder]]:
        """Return a context manager that yields the recorders of a survey."""
        if not self.files:
            return nullcontext(())
        from sionna_radar.survey.recordings.recorder import recorders

        return recorders(self.files, prepared, self.sample_type)


@on_one_thread
def _run(
    scenario: Scenario | Prepared,
    custom: CustomParts,
    block_size: int,
    recordings: _Recordings,
    parts: Checkpoints | None,
    workers: Workers | None,
    progress: Progress,
) -> Survey:
    watch = Stopwatch()
    with watch("prepare"):
        prepared = scenario if isinstance(scenario, Prepared) else prepare(scenario, custom, progress)
    with recordings.recorders(prepared) as kept:
        sensor, recording = record_with(
            workers,
            prepared,
            block_size=block_size,
            progress=progress,
            watch=watch,
            recorders=kept,
            parts=parts,
        )
        progress("mapping", 0, 0)
        with watch("map"):
            if len(recording.echoes) > MANY_ECHOES:
                let_rest(sensor)
                release_arrays()
                release_memory()
            points = place(recording.echoes, sensor, prepared.flight, block_size=block_size)
            estimate = map_with(workers, prepared, recording, points, progress, parts)
        with watch("compare"):
            comparison = prepared.truth().compare(estimate.dem, points, recording.lit)
            chirp = sensor.record_chirp(prepared.flight.pulses(np.array([len(prepared) // 2])))
        for recorder in kept:
            recorder.finish(comparison)
    return Survey(
        prepared=prepared,
        paths=recording.paths,
        points=points,
        dem=estimate.dem,
        dem_sigma=estimate.sigma,
        dem_sigma_navigation=navigation_sigma(
            estimate.dem,
            points,
            prepared.flight,
            prepared.mapper.analyser.chirp,
            prepared.local.processing.doppler_correction,
        ),
        uncertainty=estimate.uncertainty,
        truth=comparison.truth,
        error=comparison.error,
        lit=comparison.lit,
        dem_error=comparison.dem_error,
        lit_error=comparison.lit_error,
        off_wall_error=comparison.off_wall_error,
        overhang=comparison.overhang,
        chirp=chirp,
        timing_s=watch.seconds(),
        peak_memory_mb=peak_memory_mb(),
        warnings=_warnings(prepared, recording, points, comparison.lit_error, estimate),
        sensor=sensor,
        saturation=_saturation(prepared, recording),
        no_echo=recording.silent & comparison.lit & ~estimate.dem.filled,
    )


def _saturation(prepared: Prepared, recording: Recording) -> Saturation | None:
    if prepared.local.sensor != "radar" or not prepared.local.radar.receiver.converter.limited:
        return None
    return Saturation(saturated_pulses=recording.saturated_pulses, saturated_samples=recording.saturated_samples)


def _burst_warnings(prepared: Prepared) -> tuple[str, ...]:
    chirps = prepared.local.processing.average.chirps
    if chirps == 1 or prepared.antenna is None or len(prepared) < 2:
        return ()
    here = prepared.flight.sample(WARNED_PULSES).index
    here = here[here + 1 < len(prepared)]
    ahead, next_ahead = (prepared.flight.pulses(index).measured.boresight for index in (here, here + 1))
    to_next = np.arccos(np.clip(np.einsum("pi,pi->p", ahead, next_ahead), -1, 1))
    return burst_warnings(chirps, to_next * (chirps - 1) / chirps, prepared.antenna.beamwidths_rad)


def _louder(prepared: Prepared) -> str:
    """Return the keys that raise echoes over what hides them."""
    radar = prepared.local.radar
    rounding = rounding_over_noise(radar, prepared.receiver) if prepared.local.sensor == "radar" else None
    if rounding is None or rounding <= 1:
        return LOUDER.get(prepared.local.sensor, LOUDER["radar"])
    key = "bits" if radar.receiver.converter.full_scale_dbm is None else "gain_db"
    return f"radar.receiver.converter.{key} (its rounding lies {to_db(rounding):.0f} dB over the thermal noise)"


def _warnings(
    prepared: Prepared, recording: Recording, points: Points, lit: DemError, estimate: Estimate
) -> tuple[str, ...]:
    """Return the warnings about a survey's result, and log those not logged during preparation."""
    warnings = prepared.flown.warnings + warnings_of(
        len(recording.echoes),
        recording.rain_echoes,
        recording.lost_to_rain,
        len(prepared),
        prepared.local.weather.falling or "air",
        None if prepared.expected_ground is None else "processing.expected_ground",
        stepped_behind_volume=prepared.mapper.name == "stepped" and recording.behind_volume,
        louder=_louder(prepared),
    )
    found, sampled = len(recording.echoes), prepared.flight.sample(WARNED_PULSES).measured
    if prepared.angle is not None and found == 0:
        warnings = prepared.flown.warnings  # what follows says more than that there is no echo
    warnings += direction_warnings(prepared.angle, sampled, found)
    local = prepared.local
    warnings += idle_receiver_warnings(local.processing.angle, local.radar.second_receiver)
    warnings += _burst_warnings(prepared)
    mapper, headroom_db = prepared.mapper, prepared.local.radar.receiver.converter.agc_headroom_db
    warnings += saturation_warnings(recording.saturated_pulses, len(prepared), headroom_db)
    spacing_m = prepared.mapper.grid.spacing_m
    warnings += map_warnings(points, len(prepared), lit.count, lit.coverage, spacing_m, _louder(prepared))
    warnings += unexplained_warnings(estimate.uncertainty, found, mapper.name)
    warnings += steered_warnings(len(prepared.beams), mapper.name, mapper.method.profiles)
    warnings += sight_warnings(local.sensor, {"vegetation": local.vegetation, "targets": local.targets})
    for warning in warnings:
        logger.warning("%s", warning)
    return prepared.warnings + warnings
