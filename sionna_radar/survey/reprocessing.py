"""Reprocessing of recorded beat signals into ranges, points and a DEM, without the scene.

A recording is a source of beat signals: it is observed, placed, mapped and compared as a survey is.
"""

import json
import logging
import math
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Inexact, Int
from scipy.spatial import KDTree

from sionna_radar.accuracy.truth import Comparison, compare_dem
from sionna_radar.detection.angle.array_arrival import ArrayEstimator
from sionna_radar.detection.angle.arrival import AngleEstimator
from sionna_radar.detection.build import build_angle_estimator, build_detector, build_expected_ground
from sionna_radar.detection.detector import RESPONSE_CELLS, Detector
from sionna_radar.detection.echoes import Echoes
from sionna_radar.detection.expected_ground import ExpectedGround
from sionna_radar.execution.execution import Execution
from sionna_radar.execution.workers import Task
from sionna_radar.flight.build import build_errors, build_scan, build_stated_errors
from sionna_radar.flight.instrument import BelievedMotion, InstrumentErrors, believed_motion
from sionna_radar.flight.navigation import KnownPoses, StatedError
from sionna_radar.flight.pulses import Pose, Pulses
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.input_file import shown
from sionna_radar.foundation.linear_algebra import on_one_thread
from sionna_radar.foundation.progress import stage
from sionna_radar.foundation.raster import Grid, Raster, box_around
from sionna_radar.foundation.stopwatch import timed, timing
from sionna_radar.mapping.build import build_dem_method, build_mapper, speckle_memory
from sionna_radar.mapping.canopy.point_classes import classified
from sionna_radar.mapping.mapper import Mapper, dem_grid
from sionna_radar.mapping.navigation.refinement import STEPS, RefinedNavigation
from sionna_radar.mapping.points import Points
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.build import build_antenna, build_array, build_receivers, build_sweeps, squinting
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.loading import content_key
from sionna_radar.scenario.radar import refuse_average
from sionna_radar.scenario.readers import DESCRIBED_RECORDING
from sionna_radar.scenario.recorded import RecordedSettings, recorded_scenario, recorded_settings
from sionna_radar.signal.build import build_high_pass
from sionna_radar.survey.custom_parts import CustomParts, refuse_for_workers
from sionna_radar.survey.instrument import processing_limits
from sionna_radar.survey.map_positions import in_local_frame
from sionna_radar.survey.navigation import check_navigation_reference, navigation_warnings, refined_navigation
from sionna_radar.survey.observation import Observed, SegmentObserver, observe
from sionna_radar.survey.obstacles import ground_echoes, report_obstacles, reports_obstacles, rule_of
from sionna_radar.survey.placement import place
from sionna_radar.survey.recordings.described import WHOLE_CELLS, Described, DescribedRanges, DescribedSignals
from sionna_radar.survey.recordings.signal_file import RecordedPulses, RecordedTruth, SignalFile, open_signals
from sionna_radar.survey.result import Processed, RangeSpectrum
from sionna_radar.survey.sensors.sensor import Observation, Sensor
from sionna_radar.survey.sensors.sweeps import ChirpRecord, SweepDetector
from sionna_radar.tracing.paths import Paths

logger = logging.getLogger("sionna_radar")

RecordingFile = SignalFile | DescribedSignals | DescribedRanges

# Pulses sampled over the recording for the mean and median spectrum.
SPECTRUM_PULSES = 512
# Share of the echoes' energy in the farther half of an I/Q band, and their strongest cell over the noise, above which
# the samples may be conjugated.
BAND_HELD, STRONG = 0.9, 10.0
CONJUGATE = "radar.conjugate"
# Without a scan that says how far beams lie apart, a map closes gaps up to this quantile of the points' distances.
SPACING_QUANTILE = 0.99


# Poses whose ground a reference must have heights of, and cells along the longer side of that ground.
SAMPLED_POSES, COARSE_CELLS = 2000, 500


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


def identity_of(path: Path, overrides: Mapping[str, Any], block_size: int) -> dict[str, Any]:
    """Return the inputs that segments of a recording depend on, as JSON; InputFileError for no recording."""
    with _opened(path) as file:
        files = [path, *(file.files if isinstance(file, Described) else ())]
    return {"recording": content_key({"files": files}), "settings": dict(overrides), "block_size": block_size}


@contextmanager
def open_recording(
    path: Path, overrides: Mapping[str, Any], parts: CustomParts | None = None
) -> Iterator["RecordingSource"]:
    """Open a recording, and check its processing settings; see `process`."""
    with _opened(path) as file:
        yield _source(path, file, dict(overrides), parts or CustomParts())


def _opened(path: Path) -> AbstractContextManager[RecordingFile]:
    return DESCRIBED_RECORDING(path) if path.suffix.lower() == ".toml" else open_signals(path)


@dataclass(frozen=True, kw_only=True)
class RecordingSource:
    """An open recording with the settings of its processing, as a source of beat signals.

    overrides, parts: as they were given; settings: with all values.
    conjugate: whether the samples' Q has the other sign.
    known_errors: of the instrument, in place of those of the settings; estimated: poses that its echoes refined.
    """

    path: Path
    overrides: Mapping[str, Any]
    parts: CustomParts
    file: RecordingFile
    settings: Scenario | RecordedSettings
    conjugate: bool
    known_errors: InstrumentErrors | None = None
    estimated: KnownPoses | None = None
    sweeps: tuple[Chirp, ...]
    antenna: Antenna
    detector: Detector
    angle: AngleEstimator | ArrayEstimator | None = None
    bursts: None = None
    activity: str = "detecting"

    @cached_property
    def flight(self) -> RecordedPulses:
        """The pulses, without known errors of the instrument."""
        pulses, errors = self.file.pulses, self.errors
        if self.estimated is not None:
            return replace(pulses, poses=self.estimated.pose.rows)
        if errors is None or not pulses.located:
            return pulses
        return replace(pulses, poses=self.believed().without(errors).pose.rows)

    @property
    def errors(self) -> InstrumentErrors | None:
        """Known errors of the instrument, which processing takes out."""
        table = self.settings.processing.calibration
        return self.known_errors if table is None else build_errors(table)

    def corrected(self, errors: InstrumentErrors) -> "RecordingSource":
        """Return the recording without errors of the instrument."""
        return replace(self, known_errors=errors)

    def believed(self) -> BelievedMotion:
        """Return the recorded motion of all pulses, as it was reported."""
        scan = build_scan(self.settings.radar.scan) if isinstance(self.settings, Scenario) else None
        pulses = self.file.pulses
        return believed_motion(pulses.pulses(np.arange(len(pulses))), scan)

    @property
    def keeps_profiles(self) -> bool:
        """Whether range profiles around the echoes are used: by the DEM method, or to refine the navigation."""
        if self.settings.processing.navigation == "refined":
            return True
        return (self.parts.dem_method or build_dem_method(self.settings.dem)).profiles != "unused"

    def document(self) -> dict[str, Any]:
        """Return the path and the settings, JSON, for workers; PluginError where parts were given in Python."""
        refuse_for_workers(self.parts.described())
        return {"recording": str(self.path.absolute()), "overrides": json.dumps(dict(self.overrides))}

    def tally(self) -> None:
        """Return None: a recording holds no true hits."""

    def build_sensor(self) -> "RecordedSensor | RangeReadings":
        """Return the detector of its echoes, or the readings themselves."""
        if isinstance(self.file, DescribedRanges):
            return RangeReadings(self.file, self.errors)
        expected, flight = self.settings.processing.expected_ground, self.file.flight
        ground = None
        if expected is not None and flight is not None:
            grid = self.mapper_of(None).grid
            ground = build_expected_ground(expected, flight.altitude_m, self.antenna, grid, self.file.georeference)
        return RecordedSensor(self, ground)

    def pose(self, index: Int[np.ndarray, " pulse"]) -> Pose:
        """Return the measured poses of pulses, without known errors of the instrument."""
        return self.flight.pulses(index).measured

    def beats(self, pulses: Pulses) -> list[Inexact[np.ndarray, "pulse sample"]]:
        """Return the beat signals of each sweep of pulses, of an array those of one chirp and receiver."""
        return [beat.reshape(len(beat), -1, beat.shape[-1])[:, 0] for beat in self.signals(pulses)]

    def signals(self, pulses: Pulses) -> list[Inexact[np.ndarray, "pulse *channel sample"]]:
        """Return all beat signals of pulses, echoes at positive frequencies."""
        assert not isinstance(self.file, DescribedRanges), "readings have no signals"
        beats = self.file.beats(pulses)
        return [beat.conj() for beat in beats] if self.conjugate else beats

    def mappable_grid(self) -> Grid:
        """Return the grid of the DEM if known, or coarse cells in reach; InputFileError without poses."""
        if not self.flight.located:
            message = f"{shown(self.path)} has no poses, so that there is no DEM to compare; leave the reference out"
            raise InputFileError(message)
        if self.file.flight is not None:
            return self.mapper_of(None).grid
        place_m = self.flight.sample(SAMPLED_POSES).measured.position_m[:, :2]
        ranges_m = self.file.range_m if isinstance(self.file, DescribedRanges) else np.array(self.sweeps[0].max_range_m)
        reach_m = float(np.max(ranges_m[np.isfinite(ranges_m)], initial=0.0))
        west, south, east, north = box_around(place_m, reach_m)
        spacing_m = max(self.settings.dem.spacing_m, max(east - west, north - south) / COARSE_CELLS)
        grid = Grid.covering(west, south, east, north, spacing_m)
        return replace(grid, georeference=self.file.georeference)

    def mapper_of(self, points: Points | None) -> Mapper:
        """Return the mapper: of the ground that a simulated flight was to see, or of that under the points."""
        dem, flight = self.settings.dem, self.file.flight
        gap_m = dem.max_gap_m or (max(2 * dem.spacing_m, flight.beam_spacing_m) if flight else None)
        if flight is not None:
            extent_m = flight.ground_extent_m
        else:
            assert points is not None
            place_m = points.position_m[:, :2]
            extent_m = box_around(place_m)
            if not gap_m:
                # The distance that all but a hundredth of the points have a neighbour within.
                nearest_m = KDTree(place_m).query(place_m, k=min(2, len(place_m)))[0].reshape(len(place_m), -1)[:, -1]
                gap_m = max(2 * dem.spacing_m, float(np.quantile(nearest_m, SPACING_QUANTILE)))
        assert gap_m is not None
        scenario = self.settings if isinstance(self.settings, Scenario) else None
        return build_mapper(
            dem,
            dem_grid(dem.spacing_m, extent_m, gap_m, self.file.georeference),
            gap_m,
            None if isinstance(self.file, DescribedRanges) or isinstance(self.angle, ArrayEstimator) else self.antenna,
            self.detector.analyser,
            self.settings.processing.doppler_correction,
            self.parts.dem_method,
            None if scenario is None else speckle_memory(scenario),
            measured_ground=scenario is None or scenario.measured_ground,
            errors=self.errors,
            ground=None if scenario is None or dem.cover == "unknown" else in_local_frame(scenario),
        )


class RecordedSensor:
    """Detects the echoes in recorded beat signals."""

    def __init__(self, source: RecordingSource, expected_ground: ExpectedGround | None) -> None:
        self._source, self._errors, self._expected = source, source.errors, expected_ground
        self.sweeps = SweepDetector(
            detector=source.detector,
            sweeps=source.sweeps,
            schedule=source.flight,
            expected_ground=expected_ground,
            beats=source.beats,
        )

    def observe(self, pulses: Pulses) -> Observation:
        """Return the echoes of a block of pulses."""
        with timed("read"):
            angle = self._source.angle
            beats = self._source.beats(pulses) if angle is None else self._source.signals(pulses)
        if angle is not None:
            with timed("detect"):
                echoes = (
                    angle.find_all(beats[0], pulses, self._expected)
                    if isinstance(angle, ArrayEstimator)
                    else self.sweeps.directions(angle, list(np.moveaxis(beats[0][:, 0], 1, 0)), pulses)
                )
            return Observation(paths=Paths.none(), echoes=echoes)
        with timed("detect"):
            seen = self.sweeps.detect(beats, pulses)
        return Observation(
            paths=Paths.none(),
            echoes=seen.echoes,
            profiles=seen.profiles,
            through_volume=seen.through_volume,
            beats=beats,
        )

    def correct(self, echoes: Echoes, pulse: Int[np.ndarray, " pulse"], measured: Pose) -> Echoes:
        """Return echoes without the Doppler shift of still ground, where the poses are known."""
        known = np.isfinite(measured.velocity_mps).all()
        corrected = self.sweeps.correct(echoes, pulse, measured) if known else echoes
        return _without(self._errors, corrected)

    def record_chirp(self, pulses: Pulses) -> ChirpRecord:
        """Return the chirp of one pulse with what is found in it."""
        return self.sweeps.record_chirps(pulses)[0]


@dataclass(frozen=True)
class RangeReadings:
    """A sensor whose ranges were read before."""

    file: DescribedRanges
    errors: InstrumentErrors | None = None

    def observe(self, pulses: Pulses) -> Observation:
        """Return the readings of a block of pulses."""
        return Observation(paths=Paths.none(), echoes=self.file.echoes(pulses))

    def correct(self, echoes: Echoes, pulse: Int[np.ndarray, " pulse"], measured: Pose) -> Echoes:
        """Return the readings, in which whoever read them has corrected what there was, without known errors."""
        del pulse, measured
        return _without(self.errors, echoes)

    def record_chirp(self, pulses: Pulses) -> None:
        """Return None: no chirps are known."""


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


def _source(path: Path, file: RecordingFile, overrides: dict[str, Any], parts: CustomParts) -> RecordingSource:
    source = str(path)
    given = {
        "radar.antenna": parts.antenna,
        "processing.ranging": parts.range_estimator,
        "dem.method": parts.dem_method,
    }
    for key, what in file.replaced.items():
        if key in given and given[key] is None and key not in overrides:
            message = f"was replaced by {what} in the flight, which no file can hold; give it to `process`"
            raise ScenarioError.of(key, message, source)
    if isinstance(file, DescribedSignals) and file.powers and (wrong := WHOLE_CELLS.keys() & overrides.keys()):
        message = "has no effect on powers: range profiles keep their cells; leave it out"
        raise ScenarioError.of(min(wrong), message, source)
    changes = {**file.settings, **overrides} if isinstance(file, Described) else overrides
    settings: Scenario | RecordedSettings
    if file.scenario is None:
        settings, sweeps = recorded_settings(changes, source), file.sweeps
        conjugate = settings.radar.conjugate
    else:
        # No key of a scenario, whose own samples have the usual sign.
        conjugate = overrides.get(CONJUGATE, False)
        if not isinstance(conjugate, bool):
            raise ScenarioError.of(CONJUGATE, f"must be true or false, not {shown(conjugate)}", source)
        own = {key: value for key, value in overrides.items() if key != CONJUGATE}
        settings = recorded_scenario(file.scenario, own, source)
        sweeps = build_sweeps(settings.radar)
        check_same_radar(sweeps, file.sweeps, source)
    if conjugate and sweeps[0].sampling == "real":
        message = "true has no effect on real samples; leave it out, or record beat_q as well"
        raise ScenarioError.of(CONJUGATE, message, source)
    processing = settings.processing
    if misfit := processing.cfar.misfit(sweeps[0].range_cells):
        message = f"{misfit} of the recording; lower processing.cfar.guard and processing.cfar.training"
        raise ScenarioError.of("processing.cfar.guard", message, source)
    if problems := [*processing_limits(processing, sweeps[0])]:
        raise ScenarioError(problems, source)
    refuse_average(processing, "a recording")
    if not file.pulses.located:
        # Rain and ground are distinguished by the geometry of the beam.
        processing = processing.model_copy(update={"volume_clutter": "off"})
    if processing.expected_ground is not None and file.flight is None:
        message = "needs the flight of a simulated survey, which this recording does not have; leave it out"
        raise ScenarioError.of("processing.expected_ground", message, source)
    antenna, _ = squinting(settings.radar.antenna, parts.antenna or build_antenna(settings.radar.antenna), sweeps)
    if (
        isinstance(file, DescribedRanges)
        and (parts.dem_method or build_dem_method(settings.dem)).profiles == "required"
    ):
        message = "needs range profiles, which readings do not have; set dem.method = 'smooth'"
        raise ScenarioError.of("dem.method", message, source)
    high_pass = build_high_pass(settings.radar.receiver)
    detector = build_detector(
        processing,
        sweeps[0],
        antenna,
        high_pass,
        parts.range_estimator,
        transmit_power_w=None if isinstance(file, DescribedRanges) else file.radar.transmit_power_w,
        reports_obstacles=reports_obstacles(settings),
    )
    return RecordingSource(
        path=path,
        overrides=overrides,
        parts=parts,
        file=file,
        settings=settings,
        conjugate=conjugate,
        sweeps=sweeps,
        antenna=antenna,
        detector=detector,
        angle=_angle_estimator(file, settings, detector, antenna, source),
    )


def _angle_estimator(
    file: RecordingFile, settings: Scenario | RecordedSettings, detector: Detector, antenna: Antenna, source: str
) -> AngleEstimator | ArrayEstimator | None:
    """Return the estimator of points from several receivers, None for one; ScenarioError for another array."""
    channels = () if isinstance(file, DescribedRanges) else file.channels
    if settings.processing.angle != "off":
        array = None
        if isinstance(settings, Scenario):
            radar = settings.radar
            array = build_receivers(radar.second_receiver, antenna, detector.analyser.chirp, 1 / radar.chirp_rate_hz)
        if array is None or channels != (1, len(array.receiver_m)):
            message = f"{settings.processing.angle!r} needs all receivers, which the recording does not have; set 'off'"
            raise ScenarioError.of("processing.angle", message, source)
        return build_angle_estimator(settings.processing, detector, antenna, array)
    table, chirp = settings.radar.array, detector.analyser.chirp
    if isinstance(file, DescribedRanges) or (table is None and channels[:1] in ((), (1,))):
        return None
    if table is None:
        message = "missing; frames of several receivers need the places of their elements"
        raise ScenarioError.of("radar.array", message, source)
    period_s = file.radar.chirp_period_s
    if period_s is None:
        raise ScenarioError.of("radar:chirp_period_s", "missing; frames of an array need it", source)
    array = build_array(table, chirp, period_s, 0)
    if channels != (array.chirps, len(array.receiver_m)):
        recorded = "frames of {} chirps of {} receivers".format(*channels) if channels else "single chirps"
        recorded += "; change it, or give it in the description of the samples"
        message = f"has {array.chirps} chirps in a frame and {len(array.receiver_m)} receivers; recorded are {recorded}"
        raise ScenarioError.of("radar.array", message, source)
    return build_angle_estimator(settings.processing, detector, antenna, array, table)


def check_same_radar(wanted: tuple[Chirp, ...], recorded: tuple[Chirp, ...], source: str) -> None:
    """Raise ScenarioError if the radar of the settings differs from that of the samples."""
    if len(wanted) != len(recorded):
        raise ScenarioError.of("radar.sweep", "is not that of the recorded samples; record them again", source)
    for name, ours in vars(wanted[0]).items():
        theirs = getattr(recorded[0], name)
        same = math.isclose(ours, theirs, rel_tol=1e-9) if isinstance(ours, int | float) else ours == theirs
        if not same:
            message = f"the scenario's {name} is {ours}, that of the recorded samples {theirs}; record them again"
            raise ScenarioError.of("radar", message, source)


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
                rule = rule_of(source.settings, mapper)
                estimate = mapper.map(*ground_echoes(points, observed.profiles, mapper, source.pose, rule), source.pose)
                points = classified(points, estimate)
                reported, _ = report_obstacles(points, estimate, mapper, source.pose, rule, len(flight))
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


def _without(errors: InstrumentErrors | None, echoes: Echoes) -> Echoes:
    """Return echoes at their true ranges, if errors of the instrument are known."""
    return echoes if errors is None else replace(echoes, range_m=errors.true_m(echoes.range_m))


def _poses(path: Path, index: Int[np.ndarray, " pulse"]) -> Pose:
    """Return measured poses from a recording that has been closed since."""
    with _opened(path) as file:
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
    if spectrum is not None and complex_signals and _turned(spectrum, source.detector):
        warnings += (
            f"{BAND_HELD:.0%} of the energy of echoes lies in the farther half of the ranges, as where Q has the other "
            f"sign; if none is expected there, set radar.conjugate = {str(not source.conjugate).lower()}",
        )
    if len(echoes) == 0:
        warnings += ("no echo was detected; lower processing.cfar.guard or raise false_alarm_probability",)
    elif comparison is not None and comparison.lit_error.count == 0:
        warnings += ("no cell of the DEM is filled where the main beam reached; look at the poses",)
    elif dem is not None and not dem.filled.any():
        warnings += ("no cell of the DEM is filled; for points along a line set dem.method = 'smooth'",)
    for warning in warnings:
        logger.warning("%s", warning)
    return warnings


def _turned(spectrum: RangeSpectrum, detector: Detector) -> bool:
    """Return True if only the farther half of the ranges holds energy: I/Q samples with negative beat frequencies.

    Leakage stands at both ends of the band, and is left out with the window's response of it.
    """
    left_out = RESPONSE_CELLS * detector.analyser.zero_padding
    echo = np.maximum(spectrum.mean - spectrum.floor, 0.0)[left_out:-left_out]
    half = len(spectrum.mean) // 2 - left_out
    return bool(echo.max(initial=0.0) > STRONG * spectrum.floor and echo[half:].sum() > BAND_HELD * echo.sum())
