"""Reprocessing of recorded beat signals into ranges, points and a DEM, without the scene.

A recording is a source of beat signals: it is observed, placed, mapped and compared as a survey is.
"""

import json
import logging
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from sionna_radar.accuracy.truth import Comparison, compare_dem
from sionna_radar.detection.detector import RESPONSE_CELLS, Detector
from sionna_radar.detection.echoes import Echoes
from sionna_radar.execution.execution import Execution
from sionna_radar.execution.workers import Task
from sionna_radar.flight.build import build_stated_errors
from sionna_radar.flight.navigation import StatedError
from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.linear_algebra import on_one_thread
from sionna_radar.foundation.progress import stage
from sionna_radar.foundation.raster import Raster
from sionna_radar.foundation.stopwatch import timed, timing
from sionna_radar.mapping.canopy.point_classes import classified
from sionna_radar.mapping.navigation.refinement import STEPS, RefinedNavigation
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scenario import Scenario
from sionna_radar.survey.custom_parts import CustomParts
from sionna_radar.survey.navigation import check_navigation_reference, navigation_warnings, refined_navigation
from sionna_radar.survey.observation import Observed, SegmentObserver, observe
from sionna_radar.survey.obstacles import report_obstacles
from sionna_radar.survey.placement import place
from sionna_radar.survey.recording_source import (
    RangeReadings,
    RecordedSensor,
    RecordingSource,
    open_recorded_file,
    open_recording,
)
from sionna_radar.survey.recordings.described import DescribedRanges
from sionna_radar.survey.recordings.signal_file import RecordedTruth
from sionna_radar.survey.result import Processed, RangeSpectrum
from sionna_radar.survey.sensors.sensor import Sensor
from sionna_radar.survey.sensors.sweeps import ChirpRecord

logger = logging.getLogger("sionna_radar")

# Pulses sampled over the recording for the mean and median spectrum.
SPECTRUM_PULSES = 512
# Share of the echoes' energy in the farther half of an I/Q band, and their strongest cell over the noise, above which
# the samples may be conjugated.
BAND_HELD, STRONG = 0.9, 10.0


def process(
    recording: str | Path,
    overrides: Mapping[str, Any] | None = None,
    *,
    parts: CustomParts | None = None,
    execution: Execution | None = None,
) -> Processed:
    """Process recorded or measured beat signals into ranges, points and a DEM.

    Neither the scene nor the ray tracer is needed. With unchanged settings and samples of 64 bits, points and DEM
    are those of the simulation, bit for bit.

    Parameters
    ----------
    recording:
        A netCDF file of `run(..., recordings={"signals": ...})` or in the layout of `survey.recordings.signal_file`; or
        a TOML file that describes samples, range profiles or readings, see `survey.recordings.described`.
    overrides:
        Values of `processing` and `dem`, and `radar.conjugate`, by dotted keys; for a recording without a scenario also
        of `radar.antenna` and `radar.receiver`.
    parts:
        Custom antenna, range estimator and DEM method; custom parts of the simulated flight must be given again.
    execution:
        As for `run`.

    Returns
    -------
    Echoes; points and a DEM if poses are known; their error if the recording holds the simulated truth.

    Raises
    ------
    InputFileError
        The file is no recording, or is damaged.
    ScenarioError
        A setting does not fit, or is fixed by the recording.

    Examples
    --------
    >>> run(load_scenario("hills", {"platform.length_m": 10.0}), recordings={"signals": "flight.nc"}).pulses
    100
    >>> process("flight.nc", {"dem.spacing_m": 2.0}).dem.grid.spacing_m
    2.0
    """
    execution = execution or Execution()
    with execution.reported(), open_recording(Path(recording), dict(overrides or {}), parts) as source:
        with timing() as watch:
            processed = _processed(source, execution)
        return replace(processed, timing_s=watch.seconds())


@on_one_thread
def recorded_segment_task(task: Task) -> bytes:
    """Process a segment of a recording on a worker, and return it serialised."""
    source, sensor, _ = _on_this_worker(task["recording"], task["overrides"])
    return SegmentObserver(source, sensor, task["blocks"]).segment(task)


@lru_cache(maxsize=1)
def _on_this_worker(path: str, overrides: str) -> tuple[RecordingSource, RecordedSensor | RangeReadings, ExitStack]:
    """Return a recording, its sensor and its open file, cached for the segments of one recording."""
    kept_open = ExitStack()
    source = kept_open.enter_context(open_recording(Path(path), json.loads(overrides)))
    return source, source.build_sensor(), kept_open


@on_one_thread
def _processed(source: RecordingSource, execution: Execution) -> Processed:
    """Observe, place, map and compare."""
    file, flight = source.file, source.flight
    check_refined_recording(source)
    sensor, observed = observe(source, execution, work=recorded_segment_task)
    navigation = refined_recording(source, sensor, observed)
    if navigation is not None and navigation.holds:
        source = replace(source, estimated=navigation.poses)
        flight = source.flight
    estimate, points, reported, echoes = None, None, None, observed.echoes
    with stage("mapping"), timed("map"):
        if flight.located:
            points = place(echoes, sensor, flight)
            echoes = replace(echoes, range_m=points.range_m, range_sigma_m=points.range_sigma_m)
            if len(points) or file.flight:
                mapper = source.mapper_of(points)
                estimate = mapper.map(points, observed.profiles, source.pose)
                points = classified(points, estimate)
                reported, _ = report_obstacles(points, estimate, mapper, source.pose, len(flight))
    with timed("compare"):
        comparison = None if estimate is None else _compared(estimate.dem, file.truth)
    # From the file, or from memory without known errors.
    in_memory = None if source.errors is None and source.estimated is None else flight.poses
    readings = isinstance(file, DescribedRanges)
    spectrum = None if readings else mean_spectrum(source)
    return Processed(
        source=source.path,
        overrides=source.overrides,
        settings=source.settings,
        sweeps=() if readings else source.sweeps,
        time_s=flight.time_s,
        echoes=echoes,
        points=points,
        measured=(in_memory or partial(_poses, source.path)) if flight.located else None,
        dem=None if estimate is None else estimate.dem,
        dem_sigma=None if estimate is None else estimate.sigma,
        uncertainty=None if estimate is None else estimate.uncertainty,
        canopy=None if estimate is None else estimate.canopy,
        comparison=comparison,
        georeference=file.georeference,
        spectrum=spectrum,
        chirp=sensor.record_chirp(flight.pulses(np.array([len(flight) // 2]))),
        record_chirps=partial(_chirps, source),
        obstacles=reported,
        navigation=navigation,
        warnings=(
            *_warnings(source, echoes, None if estimate is None else estimate.dem, comparison, spectrum),
            *navigation_warnings(navigation, source.settings.processing.navigation == "refined"),
        ),
    )


def check_refined_recording(source: RecordingSource) -> None:
    """Raise ScenarioError or InputFileError, as `refined_recording`, before echoes are detected.

    The ground of a recording without a simulated flight is not known yet: its reference must have heights in reach.
    """
    processing = source.settings.processing
    if processing.navigation != "refined":
        return
    if isinstance(source.file, DescribedRanges) or not source.flight.located:
        message = "'refined' needs poses and range profiles, which the recording does not have; set 'reported'"
        raise ScenarioError.of("processing.navigation", message, str(source.path))
    _stated_errors(source)
    if processing.refined_navigation.reference is not None:
        check_navigation_reference(processing.refined_navigation, source.mappable_grid())


def _stated_errors(source: RecordingSource) -> tuple[StatedError, ...]:
    platform = source.settings.platform if isinstance(source.settings, Scenario) else None
    table = source.settings.processing.refined_navigation
    return build_stated_errors(table, None if platform is None else platform.navigation)


def refined_recording(source: RecordingSource, sensor: Sensor, observed: Observed) -> RefinedNavigation | None:
    """Return the navigation of a recording as its echoes refine it; None if its processing does not."""
    processing, flight = source.settings.processing, source.flight
    if processing.navigation != "refined":
        return None
    stated = _stated_errors(source)
    flown, points = source.believed(), place(observed.echoes, sensor, flight)
    if source.errors is not None:
        flown = flown.without(source.errors)
    if len(points) == 0:
        return None
    with stage("refining the navigation", STEPS), timed("navigation"):
        mapper = source.mapper_of(points)
        return refined_navigation(processing.refined_navigation, observed.profiles, flown, mapper, stated)


def _compared(dem: Raster, truth: RecordedTruth | None) -> Comparison | None:
    """Compare the DEM with the recorded truth; None if there is none on its grid."""
    if truth is None or truth.surface.grid != dem.grid:
        return None
    return compare_dem(dem, truth.surface, truth.lit, truth.beside_wall)


def _poses(path: Path, index: Int[np.ndarray, " pulse"]) -> Pose:
    """Return measured poses from a recording that has been closed since."""
    with open_recorded_file(path) as file:
        return file.pose(index)


def _chirps(source: RecordingSource, index: Int[np.ndarray, " pulse"]) -> list[ChirpRecord]:
    """Return records of pulses from a recording that has been closed since."""
    with open_recording(source.path, source.overrides, source.parts) as again:
        sensor = again.build_sensor()
        return [] if isinstance(sensor, RangeReadings) else sensor.sweeps.record_chirps(again.flight.pulses(index))


def mean_spectrum(source: RecordingSource) -> RangeSpectrum:
    """Return the spectrum of pulses spread over a recording."""
    analyser = source.detector.analyser
    power = analyser.power(source.beats(source.flight.sample(SPECTRUM_PULSES))[0])
    return RangeSpectrum(range_m=analyser.range_m, mean=power.mean(axis=0), median=np.median(power, axis=0))


def _warnings(
    source: RecordingSource,
    echoes: Echoes,
    dem: Raster | None,
    comparison: Comparison | None,
    spectrum: RangeSpectrum | None,
) -> tuple[str, ...]:
    """Return and log warnings about a result."""
    warnings = source.file.warnings
    if not source.file.pulses.located:
        warnings += ("the recording has no poses: its ranges are neither corrected for Doppler nor located",)
    complex_signals = spectrum is not None and source.sweeps[0].sampling == "iq"
    if (
        spectrum is not None
        and complex_signals
        and _turned(spectrum, source.detector)
        and not _of_true_range(echoes, comparison, source.sweeps[0])
    ):
        warnings += (
            f"{BAND_HELD:.0%} of the energy of echoes lies in the farther half of the ranges, as where Q has the other "
            f"sign; if none is expected there, set radar.conjugate = {str(not source.conjugate).lower()}",
        )
    if len(echoes) == 0 and source.settings.processing.angle != "off":
        warnings += ("no direction was found for any echo of the receivers; set processing.angle = 'off'",)
    elif len(echoes) == 0:
        warnings += ("no echo was detected; lower processing.cfar.guard or raise false_alarm_probability",)
    elif comparison is not None and comparison.lit_error.count == 0:
        warnings += ("no cell of the DEM is filled where the main beam reached; look at the poses",)
    elif dem is not None and not dem.filled.any():
        warnings += ("no cell of the DEM is filled; for points along a line set dem.method = 'smooth'",)
    for warning in warnings:
        logger.warning("%s", warning)
    return warnings


def _of_true_range(echoes: Echoes, comparison: Comparison | None, chirp: Chirp) -> bool:
    """Return True if recorded truth is nearer to the ranges as they are read than to those of the other sign."""
    if comparison is None or comparison.lit_error.count == 0:
        return False
    # The other sign reads R as the greatest range less R.
    halfway_m = abs(float(np.median(echoes.range_m)) - chirp.max_range_m / 2)
    return comparison.lit_error.rms_m < halfway_m


def _turned(spectrum: RangeSpectrum, detector: Detector) -> bool:
    """Return True if only the farther half of the ranges holds energy: I/Q samples with negative beat frequencies.

    Leakage stands at both ends of the band, and is left out with the window's response of it.
    """
    left_out = RESPONSE_CELLS * detector.analyser.zero_padding
    echo = np.maximum(spectrum.mean - spectrum.floor, 0.0)[left_out:-left_out]
    half = len(spectrum.mean) // 2 - left_out
    return bool(echo.max(initial=0.0) > STRONG * spectrum.floor and echo[half:].sum() > BAND_HELD * echo.sum())
