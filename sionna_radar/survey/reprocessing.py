"""Recorded beat signals made into ranges, points and a DEM again, without the scene that they come from."""

import logging
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Inexact, Int
from scipy.spatial import KDTree

from sionna_radar.accuracy.compare import difference, summarise
from sionna_radar.detection.detector import RESPONSE_CELLS, Detector, build_detector
from sionna_radar.detection.echoes import Echoes, Profiles
from sionna_radar.detection.expected_ground import build_expected_ground
from sionna_radar.execution.execution import Execution
from sionna_radar.flight.pulses import Pose, Pulses
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.numerics import on_one_thread
from sionna_radar.foundation.progress import advance, stage, timed, timing
from sionna_radar.foundation.raster import Raster
from sionna_radar.mapping.echo_model.speckle import speckle_memory
from sionna_radar.mapping.mapper import DemMethod, Extent, Mapper, build_dem_method, build_mapper, dem_grid
from sionna_radar.mapping.points import Points, locate
from sionna_radar.radar.antenna import Antenna, build_antenna
from sionna_radar.radar.chirp import Chirp, build_sweeps
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.radar import refuse_average
from sionna_radar.scenario.recorded import RecordedSettings, recorded_scenario, recorded_settings
from sionna_radar.signal.analog_filters import build_high_pass
from sionna_radar.survey.checks import MAX_SPECTRUM
from sionna_radar.survey.preparation import CustomParts
from sionna_radar.survey.recordings.signal_file import SignalFile, open_signals
from sionna_radar.survey.result import DemComparison, Processed, RangeSpectrum
from sionna_radar.survey.sensors.sweeps import SweepDetector

logger = logging.getLogger("sionna_radar")

# Pulses, spread over the recording, whose spectra are kept as their mean and median.
SPECTRUM_PULSES = 512
# Share of the echoes' energy in the farther half of an I/Q band, and their strongest cell over the noise, above which
# the samples may be conjugated.
BAND_HELD, STRONG = 0.9, 10.0
# Without a scan that says how far beams lie apart, a map closes gaps up to this quantile of the points' distances.
SPACING_QUANTILE = 0.99


def process(
    recording: str | Path,
    overrides: Mapping[str, Any] | None = None,
    *,
    parts: CustomParts | None = None,
    execution: Execution | None = None,
) -> Processed:
    """Process recorded beat signals again, or those of a real radar: ranges, points and a DEM.

    Neither the scene nor the ray tracer is needed. The settings of the first run give its points and its DEM, bit for
    bit, where the samples were kept in 64 bits.

    Parameters
    ----------
    recording:
        A netCDF file: of `run(..., recordings={"signals": ...})`, or in the layout that
        `sionna_radar.survey.recordings.signal_file` describes.
    overrides:
        Values of `processing` and `dem` by dotted keys; for a recording without a scenario also of `radar.antenna`,
        `radar.receiver` and `radar.conjugate`.
    parts:
        Custom antenna, range estimator and DEM method; those of the flight that a file cannot hold must be given again.
    execution:
        As for `run`.

    Returns
    -------
    Echoes, and with poses points and a DEM; with the truth of a simulation their error.

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
    path, execution = Path(recording), execution or Execution()
    with execution.reported(), open_signals(path) as file:
        return _process(_task(path, file, dict(overrides or {}), parts or CustomParts()), execution)


@dataclass(frozen=True, kw_only=True)
class _Task:
    """A recording with the settings of its processing."""

    path: Path
    file: SignalFile
    settings: Scenario | RecordedSettings
    sweeps: tuple[Chirp, ...]
    antenna: Antenna
    detector: Detector
    method: DemMethod | None

    def beats(self, pulses: Pulses) -> list[Inexact[np.ndarray, "pulse sample"]]:
        """Return the beat signals of each sweep of pulses, echoes at positive frequencies."""
        found = self.file.beats(pulses)
        return [beat.conj() for beat in found] if self.conjugate else found

    @property
    def conjugate(self) -> bool:
        """Whether the samples' Q has the other sign."""
        return isinstance(self.settings, RecordedSettings) and self.settings.radar.conjugate

    @property
    def gap_m(self) -> float | None:
        """Largest gap that a map closes; None where only the points can tell."""
        dem, flight = self.settings.dem, self.file.flight
        return dem.max_gap_m or (max(2 * dem.spacing_m, flight.beam_spacing_m) if flight else None)

    def mapper(self, extent_m: Extent, gap_m: float) -> Mapper:
        """Return the mapper of an extent of ground."""
        settings, place = self.settings, self.file.georeference
        return build_mapper(
            settings.dem,
            dem_grid(settings.dem.spacing_m, extent_m, gap_m, place),
            gap_m,
            self.antenna,
            self.detector.analyser,
            settings.processing.doppler_correction,
            self.method,
            speckle_memory(settings) if isinstance(settings, Scenario) else None,
            measured_ground=settings.measured_ground if isinstance(settings, Scenario) else True,
        )


def _task(
    path: Path,
    file: SignalFile,
    overrides: dict[str, Any],
    parts: CustomParts,
) -> _Task:
    source = str(path)
    given = {
        "radar.antenna": parts.antenna,
        "processing.ranging": parts.range_estimator,
        "dem.method": parts.dem_method,
    }
    _check_custom_parts(file, overrides, given, source)
    settings: Scenario | RecordedSettings
    if file.scenario is None:
        settings, sweeps = recorded_settings(overrides, source), file.sweeps
        if settings.radar.conjugate and sweeps[0].sampling == "real":
            message = "true has no effect on real samples; leave it out, or record beat_q as well"
            raise ScenarioError([Problem("radar.conjugate", message)], source)
    else:
        settings = recorded_scenario(file.scenario, overrides, source)
        sweeps = build_sweeps(settings.radar)
        _check_same_radar(sweeps, file.sweeps, source)
    _check_cells(settings, sweeps[0], source)
    processing = settings.processing
    refuse_average(processing, "a recording")
    if processing.angle != "off":
        message = f"{processing.angle!r} needs all receivers, and a recording has the first one's signals; set 'off'"
        raise ScenarioError([Problem("processing.angle", message)], source)
    if not file.pulses.located:
        # Rain is told from ground by how the beam meets it.
        processing = processing.model_copy(update={"volume_clutter": "off"})
    if processing.expected_ground is not None and file.flight is None:
        message = "needs the flight of a simulated survey, which this recording does not have; leave it out"
        raise ScenarioError([Problem("processing.expected_ground", message)], source)
    antenna = parts.antenna or build_antenna(settings.radar.antenna)
    high_pass = build_high_pass(settings.radar.receiver)
    return _Task(
        path=path,
        file=file,
        settings=settings,
        sweeps=sweeps,
        antenna=antenna,
        detector=build_detector(processing, sweeps[0], antenna, high_pass, parts.range_estimator),
        method=parts.dem_method,
    )


def _check_same_radar(wanted: tuple[Chirp, ...], recorded: tuple[Chirp, ...], source: str) -> None:
    """Refuse a recording whose scenario has another radar than its samples."""
    if len(wanted) != len(recorded):
        raise ScenarioError([Problem("radar.sweep", "is not that of the recorded samples; record them again")], source)
    for name in ("carrier_hz", "bandwidth_hz", "sampling_rate_hz", "samples", "sampling", "sweep", "propagation_mps"):
        ours, theirs = getattr(wanted[0], name), getattr(recorded[0], name)
        same = ours == theirs if isinstance(ours, str) else math.isclose(ours, theirs, rel_tol=1e-9)
        if not same:
            message = f"the scenario's {name} is {ours}, that of the recorded samples {theirs}; record them again"
            raise ScenarioError([Problem("radar", message)], source)


def _check_custom_parts(
    file: SignalFile, overrides: Mapping[str, Any], given: Mapping[str, object], source: str
) -> None:
    """Refuse a recording whose flight had a custom part that is not given again."""
    for key, what in file.replaced.items():
        if key in given and given[key] is None and key not in overrides:
            message = f"was replaced by {what} in the flight, which no file can hold; give it to `process`"
            raise ScenarioError([Problem(key, message)], source)


def _check_cells(settings: Scenario | RecordedSettings, chirp: Chirp, source: str) -> None:
    processing = settings.processing
    cfar, cells = processing.cfar, chirp.samples // (2 if chirp.sampling == "real" else 1)
    if 2 * (cfar.guard + cfar.training) >= cells:
        message = (
            f"guard + training = {cfar.guard + cfar.training} cells on each side do not fit the {cells} range cells of "
            "the recording; lower processing.cfar.guard and processing.cfar.training"
        )
        raise ScenarioError([Problem("processing.cfar.guard", message)], source)
    if chirp.samples * processing.zero_padding > MAX_SPECTRUM:
        message = f"{processing.zero_padding} times {chirp.samples:,} samples are more than {MAX_SPECTRUM:,}; lower it"
        raise ScenarioError([Problem("processing.zero_padding", message)], source)


@on_one_thread
def _process(task: _Task, execution: Execution) -> Processed:
    with timing() as watch:
        return replace(_result(task, execution), timing_s=watch.seconds())


def _result(task: _Task, execution: Execution) -> Processed:
    file, pulses = task.file, task.file.pulses
    sweeps = _sweep_detector(task)
    found = _detect(task, sweeps, execution)
    estimate = comparison = None
    with stage("mapping"), timed("map"):
        if found.points is not None and (len(found.points) or file.flight):
            mapper = _mapper(task, found.points)
            estimate = mapper.map(found.points, found.profiles, file.pose)
            comparison = _compared(estimate.dem, file)
    spectrum = _spectrum(task)
    return Processed(
        source=task.path,
        settings=task.settings,
        sweeps=task.sweeps,
        time_s=pulses.time_s,
        echoes=found.echoes,
        points=found.points,
        measured=partial(_poses, task.path) if pulses.located else None,
        dem=None if estimate is None else estimate.dem,
        dem_sigma=None if estimate is None else estimate.sigma,
        comparison=comparison,
        georeference=file.georeference,
        spectrum=spectrum,
        chirp=sweeps.record_chirps(pulses.pulses(np.array([len(pulses) // 2])))[0],
        warnings=_warnings(task, found.echoes, comparison, spectrum),
    )


def _sweep_detector(task: _Task) -> SweepDetector:
    expected, file = task.settings.processing.expected_ground, task.file
    ground = None
    if expected is not None and file.flight is not None:
        grid = _mapper(task, None).grid
        ground = build_expected_ground(expected, file.flight.altitude_m, task.antenna, grid, file.georeference)
    return SweepDetector(
        detector=task.detector, sweeps=task.sweeps, schedule=file.pulses, expected_ground=ground, beats=task.beats
    )


@dataclass(frozen=True, kw_only=True)
class _Found:
    echoes: Echoes
    profiles: Profiles | None
    points: Points | None


def _detect(task: _Task, sweeps: SweepDetector, execution: Execution) -> _Found:
    """Return the echoes of a recording, block by block, located where the poses are known."""
    pulses, keeps_profiles = task.file.pulses, (task.method or build_dem_method(task.settings.dem)).profiles != "unused"
    echoes, profiles, points = [], [], []
    with stage("detecting", len(pulses)):
        for block in pulses.line_blocks(execution.block_size):
            with timed("read"):
                beats = task.beats(block)
            with timed("detect"):
                found = sweeps.detect(beats, block)
            if keeps_profiles and found.profiles is not None:
                profiles.append(found.profiles)
            if pulses.located:
                echoes.append(sweeps.correct(found.echoes, block.index, block.measured))
                points.append(locate(echoes[-1], block.index, block.measured))
            else:
                echoes.append(found.echoes)
            advance(len(block))
    return _Found(
        echoes=Echoes.concatenate(echoes),
        profiles=Profiles.concatenate(profiles) if profiles else None,
        points=Points.concatenate(points) if points else None,
    )


def _mapper(task: _Task, points: Points | None) -> Mapper:
    """Return the mapper: of the ground that a simulated flight was to see, or of that under the points."""
    flight, gap_m = task.file.flight, task.gap_m
    if flight is not None:
        assert gap_m is not None
        return task.mapper(flight.ground_extent_m, gap_m)
    assert points is not None
    place_m = points.position_m[:, :2]
    (west, south), (east, north) = place_m.min(axis=0), place_m.max(axis=0)
    if gap_m is None:
        distance_m = KDTree(place_m).query(place_m, k=min(2, len(points)))[0].reshape(len(points), -1)[:, -1]
        gap_m = max(2 * task.settings.dem.spacing_m, float(np.quantile(distance_m, SPACING_QUANTILE)))
    return task.mapper((float(west), float(south), float(east), float(north)), gap_m)


def _compared(dem: Raster, file: SignalFile) -> DemComparison | None:
    """Return the DEM against the recorded truth; None without one on its grid."""
    if file.truth is None or file.truth[0].grid != dem.grid:
        return None
    truth, lit = file.truth
    error = difference(dem, truth)
    lit = lit & truth.filled
    return DemComparison(
        truth=truth,
        error=error,
        lit=lit,
        dem_error=summarise(error, lit),
        lit_error=summarise(error.within(lit), lit),
    )


def _poses(path: Path, index: Int[np.ndarray, " pulse"]) -> Pose:
    """Return measured poses from a recording that has been closed since."""
    with open_signals(path) as file:
        return file.pose(index)


def _spectrum(task: _Task) -> RangeSpectrum:
    analyser = task.detector.analyser
    power = analyser.power(task.beats(task.file.pulses.sample(SPECTRUM_PULSES))[0])
    return RangeSpectrum(range_m=analyser.range_m, mean=power.mean(axis=0), median=np.median(power, axis=0))


def _warnings(
    task: _Task, echoes: Echoes, comparison: DemComparison | None, spectrum: RangeSpectrum
) -> tuple[str, ...]:
    """Return, and log, what degrades a result."""
    warnings: tuple[str, ...] = ()
    if not task.file.pulses.located:
        warnings = ("the recording has no poses: its ranges are neither corrected for Doppler nor located",)
    if task.file.scenario is None and task.sweeps[0].sampling == "iq" and _turned(spectrum, task.detector):
        warnings += (
            f"{BAND_HELD:.0%} of the energy of echoes lies in the farther half of the ranges, as where Q has the other "
            f"sign; if none is expected there, set radar.conjugate = {str(not task.conjugate).lower()}",
        )
    if len(echoes) == 0:
        warnings += ("no echo was detected; lower processing.cfar.guard or raise false_alarm_probability",)
    elif comparison is not None and comparison.lit_error.count == 0:
        warnings += ("no cell of the DEM is filled where the main beam reached; look at the poses",)
    for warning in warnings:
        logger.warning("%s", warning)
    return warnings


def _turned(spectrum: RangeSpectrum, detector: Detector) -> bool:
    """Return whether the nearer half of the ranges is empty, and the farther half is not: I/Q with negative beats.

    Leakage stands at both ends of the band, and is left out with the window's response of it.
    """
    left_out = RESPONSE_CELLS * detector.analyser.zero_padding
    echo = np.maximum(spectrum.mean - spectrum.floor, 0.0)[left_out:-left_out]
    half = len(spectrum.mean) // 2 - left_out
    strong = echo.max(initial=0.0) > STRONG * spectrum.floor
    return bool(strong and echo[half:].sum() > BAND_HELD * echo.sum())
