"""Recordings as sources of beat signals: their settings, checked, and their sensors.

A recording is opened with the settings of its processing; what does not fit its samples is refused.
"""

import json
import math
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Inexact, Int
from scipy.spatial import KDTree

from sionna_radar.detection.angle.array_arrival import ArrayEstimator
from sionna_radar.detection.angle.arrival import AngleEstimator
from sionna_radar.detection.build import build_angle_estimator, build_detector, build_expected_ground
from sionna_radar.detection.detector import Detector
from sionna_radar.detection.echoes import Echoes
from sionna_radar.detection.expected_ground import ExpectedGround
from sionna_radar.flight.build import build_errors, build_scan
from sionna_radar.flight.instrument import BelievedMotion, InstrumentErrors, believed_motion
from sionna_radar.flight.navigation import KnownPoses
from sionna_radar.flight.pulses import Pose, Pulses
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.input_file import shown
from sionna_radar.foundation.raster import Grid, box_around
from sionna_radar.foundation.stopwatch import timed
from sionna_radar.mapping.build import build_dem_method, build_mapper, speckle_memory
from sionna_radar.mapping.mapper import Mapper, dem_grid
from sionna_radar.mapping.points import Points
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.build import build_antenna, build_array, build_receivers, build_sweeps, squinting
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.loading import content_key
from sionna_radar.scenario.radar import RadarTable, refuse_average
from sionna_radar.scenario.readers import DESCRIBED_RECORDING
from sionna_radar.scenario.recorded import RecordedSettings, recorded_scenario, recorded_settings
from sionna_radar.signal.build import build_high_pass, build_sampled_noise
from sionna_radar.survey.custom_parts import CustomParts, refuse_for_workers
from sionna_radar.survey.instrument import processing_limits
from sionna_radar.survey.map_positions import in_local_frame
from sionna_radar.survey.obstacles import reports_obstacles, rule_of
from sionna_radar.survey.recordings.described import WHOLE_CELLS, Described, DescribedRanges, DescribedSignals
from sionna_radar.survey.recordings.signal_file import RecordedPulses, SignalFile, open_signals
from sionna_radar.survey.sensors.sensor import Observation
from sionna_radar.survey.sensors.sweeps import ChirpRecord, SweepDetector
from sionna_radar.tracing.paths import Paths

RecordingFile = SignalFile | DescribedSignals | DescribedRanges
CONJUGATE = "radar.conjugate"
# Without a scan that says how far beams lie apart, a map closes gaps up to this quantile of the points' distances.
SPACING_QUANTILE = 0.99
# Poses whose ground a reference must have heights of, and cells along the longer side of that ground.
SAMPLED_POSES, COARSE_CELLS = 2000, 500


def identity_of(path: Path, overrides: Mapping[str, Any], block_size: int) -> dict[str, Any]:
    """Return the inputs that segments of a recording depend on, as JSON; InputFileError for no recording."""
    with open_recorded_file(path) as file:
        files = [path, *(file.files if isinstance(file, Described) else ())]
    return {"recording": content_key({"files": files}), "settings": dict(overrides), "block_size": block_size}


@contextmanager
def open_recording(
    path: Path, overrides: Mapping[str, Any], parts: CustomParts | None = None
) -> Iterator["RecordingSource"]:
    """Open a recording, and check its processing settings; see `process`."""
    with open_recorded_file(path) as file:
        yield _source(path, file, dict(overrides), parts or CustomParts())


def open_recorded_file(path: Path) -> AbstractContextManager[RecordingFile]:
    """Open the file of a recording, or its description."""
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
            obstacles=rule_of(self.settings, self.detector.analyser.chirp.range_resolution_m, gap_m),
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
    settings, sweeps, conjugate = _settings(file, overrides, source)
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
        noise=build_sampled_noise(settings.radar, sweeps) if isinstance(settings.radar, RadarTable) else None,
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


def _settings(
    file: RecordingFile, overrides: Mapping[str, Any], source: str
) -> tuple[Scenario | RecordedSettings, tuple[Chirp, ...], bool]:
    """Return the settings of a recording with the overrides, its sweeps, and whether Q has the other sign."""
    if file.scenario is None:
        changes = {**file.settings, **overrides} if isinstance(file, Described) else overrides
        settings = recorded_settings(changes, source)
        return settings, file.sweeps, settings.radar.conjugate
    # No key of a scenario, whose own samples have the usual sign.
    conjugate = overrides.get(CONJUGATE, False)
    if not isinstance(conjugate, bool):
        raise ScenarioError.of(CONJUGATE, f"must be true or false, not {shown(conjugate)}", source)
    own = {key: value for key, value in overrides.items() if key != CONJUGATE}
    scenario = recorded_scenario(file.scenario, own, source)
    sweeps = build_sweeps(scenario.radar)
    check_same_radar(sweeps, file.sweeps, source)
    return scenario, sweeps, conjugate


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


def _without(errors: InstrumentErrors | None, echoes: Echoes) -> Echoes:
    """Return echoes at their true ranges, if errors of the instrument are known."""
    return echoes if errors is None else replace(echoes, range_m=errors.true_m(echoes.range_m))
