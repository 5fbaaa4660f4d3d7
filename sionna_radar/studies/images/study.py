"""Images of a side-looking flight, simulated or recorded: the slant-range one and, of coherent pulses, the focused one.

Imaging uses the measured pose and the nominal altitude only; point targets of the scene serve to measure the
resolution, like corner reflectors.
"""

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Inexact

from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.execution.execution import Execution
from sionna_radar.flight.pulses import Pose, Pulses, PulseSequence
from sionna_radar.flight.scan import SideLookingScan
from sionna_radar.foundation.errors import InputFileError, Problem, ScenarioError
from sionna_radar.foundation.progress import advance, stage
from sionna_radar.foundation.raster import Georeference
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.radar import refuse_average, refuse_gate, refuse_squint
from sionna_radar.scenario.recorded import RecordedSettings
from sionna_radar.scene.model import Target
from sionna_radar.signal.analog_filters import HighPass
from sionna_radar.signal.build import build_high_pass
from sionna_radar.studies.images.aperture import Aperture, PixelGrid, check_sampling, whole_beam
from sionna_radar.studies.images.point_response import (
    Point,
    Widths,
    isolated,
    measured_in_patch,
    measured_in_slant,
    patch_around,
    relative_to_track,
)
from sionna_radar.studies.images.sar import BackProjection, SarImage
from sionna_radar.studies.images.strip import (
    SideLooking,
    SlantImage,
    Strip,
    azimuth_resolution_m,
    focused_pixels,
    ground_range_resolution_m,
    lit_strip,
    real_aperture_resolution_m,
    slant_range_resolution_m,
    strip_along,
)
from sionna_radar.survey.checks import SAMPLED_PULSES
from sionna_radar.survey.preparation import Prepared, prepare
from sionna_radar.survey.recording_source import RecordedSensor, RecordingSource, open_recording
from sionna_radar.survey.recordings.described import DescribedRanges, DescribedSignals
from sionna_radar.survey.reprocessing import mean_spectrum
from sionna_radar.survey.sensors.radar import Radar

logger = logging.getLogger("sionna_radar")

# Energy where the mirrored strip would lie over that in the strip, outside of which the beam is under half its power.
TURNED = 2.0
# Bins of the slant-range image per range cell, and averaging intervals per resolved width at the near edge.
BINS_PER_CELL = 4
STRETCHES_PER_WIDTH = 8
# Minimum pulses in an interval, so that none is empty.
MIN_PULSES = 2


@dataclass(frozen=True, kw_only=True)
class Response:
    """Theoretical and measured widths of a point target in one image; None where not measurable."""

    theory: Widths
    measured: Widths | None


@dataclass(frozen=True, kw_only=True)
class Reflector:
    """A point target of the scene in the images; `sar` is None outside a focused image."""

    position_m: tuple[float, float, float]
    place: Point
    slar: Response
    sar: Response | None


@dataclass(frozen=True, kw_only=True)
class Imagery:
    """The images of a survey, with its scenario, or those of a recording, with the settings of its processing.

    slar, sar: theoretical half-power widths in the middle of the beam; `sar` and `focused` are None without coherence
        from pulse to pulse.
    slant, focused: the images; reflectors: the scene's point targets in them.

    Examples
    --------
    >>> scenario = load_scenario("slar", {"tracing.speckle": "per_pulse", "platform.length_m": 4.0})
    >>> imagery = image(scenario)
    >>> imagery.focused is None
    True
    """

    scenario: Scenario | RecordedSettings
    strip: Strip
    slant: SlantImage
    focused: SarImage | None
    slar: Widths
    sar: Widths | None
    reflectors: tuple[Reflector, ...]
    pulses: int
    georeference: Georeference | None
    recording: Path | None = None

    @property
    def title(self) -> str:
        """What it is of."""
        if self.recording is not None:
            return self.recording.name
        return (isinstance(self.scenario, Scenario) and self.scenario.description) or "no description"

    def __repr__(self) -> str:
        size = f"{self.slar.along_m:.3g} m x {self.slar.across_m:.3g} m in slant range"
        lines = [f"Imagery: {self.title}", f"  {self.pulses:,} pulses; SLAR {size}"]
        if self.sar:
            lines.append(f"  SAR {self.sar.along_m:.3g} m x {self.sar.across_m:.3g} m on the ground")
        return "\n".join(lines)


def image(scenario: Scenario, *, execution: Execution | None = None) -> Imagery:
    """Fly a side-looking survey and return its images.

    Parameters
    ----------
    scenario:
        The survey; `tracing.speckle = "persistent"` makes it coherent for focusing.
    execution:
        As for `sionna_radar.run`.

    Returns
    -------
    The images with their resolutions in metres; the focused one only with speckle that persists from pulse to pulse.

    Raises
    ------
    ScenarioError, InputFileError
        The radar does not look to the side of one straight track; the track is shorter than the aperture; the chirp
        rate does not sample the phase along it; or the scenario cannot be flown, see `prepare`.

    Examples
    --------
    >>> scenario = load_scenario("slar", {"tracing.speckle": "per_pulse", "platform.length_m": 4.0})
    >>> image(scenario).slar.across_m < 1.0
    True
    """
    _check(scenario)
    execution = execution or Execution()
    with execution.reported():
        prepared = prepare(scenario)
        view = _View(
            settings=prepared.scenario,
            flight=prepared.flight,
            chirp=prepared.receiver.chirp,
            antenna=prepared.instrument.antenna,
            high_pass=prepared.receiver.high_pass,
            strip=_strip(prepared),
            spacing_m=prepared.plan.flown.speed_mps / prepared.local.radar.chirp_rate_hz,
            coherent=prepared.local.tracing.speckle == "persistent",
            targets=prepared.world.scene.targets,
            georeference=prepared.world.scene.georeference,
        )
        return _imaged(view, Radar(prepared.sensor_inputs()).beat, execution)


def image_recording(
    recording: str | Path,
    overrides: Mapping[str, Any] | None = None,
    *,
    ground_m: float | None = None,
    execution: Execution | None = None,
) -> Imagery:
    """Return the images of a recording of a side-looking flight, formed along its measured poses.

    Parameters
    ----------
    recording, overrides:
        As for `process`.
    ground_m:
        Height of the ground, in the heights of the recording's map; None for that of a simulated flight.
    execution:
        As for `process`; its block size counts.

    Raises
    ------
    ScenarioError, InputFileError
        No signals of one receiver, no poses or no height of the ground; an antenna that does not look to the side of
        a straight track; and as `image`.

    Examples
    --------
    >>> scenario = load_scenario("slar", {"tracing.speckle": "per_pulse", "platform.length_m": 4.0})
    >>> run(scenario, recordings={"signals": "strip.nc"}).pulses
    400
    >>> image_recording("strip.nc").focused is None
    True
    """
    execution = execution or Execution()
    with execution.reported(), open_recording(Path(recording), dict(overrides or {})) as source:
        view, sensor = _recorded_view(source, ground_m), source.build_sensor()
        assert isinstance(sensor, RecordedSensor)
        for warning in source.file.warnings + _turned(source, view.strip):
            logger.warning("%s", warning)

        def beat(pulses: Pulses) -> Inexact[np.ndarray, "pulse sample"]:
            return sensor.sweeps.cleaned(source.beats(pulses), pulses)[0]

        return _imaged(view, beat, execution)


@dataclass(frozen=True, kw_only=True)
class _View:
    """What images are formed of.

    spacing_m: between pulses along the track; rate_hz: of them, None for chirps without a pause.
    coherent: whether they can be focused. targets: that are known.
    """

    settings: Scenario | RecordedSettings
    flight: PulseSequence
    chirp: Chirp
    antenna: Antenna
    high_pass: HighPass | None
    strip: Strip
    spacing_m: float
    coherent: bool
    targets: tuple[Target, ...]
    georeference: Georeference | None
    rate_hz: float | None = None
    recording: Path | None = None


def _imaged(
    view: _View, beat: Callable[[Pulses], Inexact[np.ndarray, "pulse sample"]], execution: Execution
) -> Imagery:
    formation = _ImageFormation(view)
    with stage("imaging", len(view.flight)):
        for pulses in view.flight.blocks(execution.block_size):
            formation.add(beat(pulses), pulses.measured)
            advance(len(pulses))
    return formation.imagery()


def _recorded_view(source: RecordingSource, ground_m: float | None) -> _View:
    file, flight = source.file, source.flight
    if isinstance(file, DescribedRanges) or source.angle is not None or len(source.sweeps) > 1 or not flight.located:
        message = f"{source.path}: an image takes signals of one sweep and one receiver, with measured poses"
        raise InputFileError(message)
    if source.sweeps[0].gate_s:
        raise InputFileError(
            f"{source.path}: has gate_delay_us = {1e6 * source.sweeps[0].gate_s:g}; images take ranges from zero on"
        )
    measured, chirp = flight.pulses(np.arange(len(flight))).measured, source.sweeps[0]
    height_m, nominal = float(measured.position_m[:, 2].mean()), file.flight
    if ground_m is not None:
        clearance_m = height_m - ground_m + (file.georeference.origin_m[2] if file.georeference else 0.0)
    elif nominal is not None:
        clearance_m = nominal.altitude_m
    else:
        raise ScenarioError.of("--ground-height", "is needed: this recording does not say it; give metres")
    strip = strip_along(measured, clearance_m, source.antenna.beamwidths_rad, chirp.max_range_m)
    spacing_m = strip.length_m / (len(flight) - 1)
    speed_mps = float(np.linalg.norm(measured.velocity_mps, axis=1).mean())
    settings = source.settings
    return _View(
        settings=settings,
        flight=flight,
        chirp=chirp,
        antenna=source.antenna,
        high_pass=build_high_pass(settings.radar.receiver),
        strip=strip,
        spacing_m=spacing_m,
        coherent=not (isinstance(file, DescribedSignals) and file.powers)
        and not (isinstance(settings, Scenario) and settings.tracing.speckle != "persistent"),
        targets=(),
        georeference=file.georeference,
        rate_hz=speed_mps / spacing_m,
        recording=source.path,
    )


def _turned(source: RecordingSource, strip: Strip) -> tuple[str, ...]:
    """Return a warning if the energy lies where the strip would stand in I/Q samples of the other sign."""
    spectrum, reach_m = mean_spectrum(source), source.sweeps[0].max_range_m
    near_m, far_m = (strip.slant_range_m(ground_m) for ground_m in (strip.near_m, strip.far_m))
    power, r = np.maximum(spectrum.mean - spectrum.floor, 0.0), spectrum.range_m
    lit, mirrored = (r >= near_m) & (r <= far_m), (reach_m - r >= near_m) & (reach_m - r <= far_m)
    right, wrong = power[lit & ~mirrored].sum(), power[mirrored & ~lit].sum()
    if source.file.scenario is not None or source.sweeps[0].sampling == "real" or wrong <= TURNED * right:
        return ()
    return (
        f"the strip is expected at {near_m:.1f} to {far_m:.1f} m, and its energy lies at {reach_m - far_m:.1f} to "
        f"{reach_m - near_m:.1f} m, as where Q has the other sign; set radar.conjugate = "
        f"{str(not source.conjugate).lower()}",
    )


def _check(scenario: Scenario) -> None:
    refuse_average(scenario.processing, "an image")
    refuse_gate(scenario.radar, "an image")
    refuse_squint(scenario.radar, "an image")
    radar, platform = scenario.radar, scenario.platform
    problems = []
    if radar.scan.mode != "side_looking":
        message = f"{radar.scan.mode!r} does not look to the side of the track; set radar.scan.mode = 'side_looking'"
        problems.append(Problem("radar.scan.mode", message))
    if scenario.sensor != "radar":
        problems.append(Problem("sensor", f"{scenario.sensor!r} makes no radar image; set sensor = 'radar'"))
    if radar.stagger > 0:
        problems.append(Problem("radar.stagger", f"{radar.stagger:g}: an image takes even intervals; set 0"))
    if radar.sweep == "triangular":
        problems.append(Problem("radar.sweep", "'triangular' is not imaged; set radar.sweep = 'up' or 'down'"))
    curved = [key for key in ("log", "lines", "wind") if getattr(platform, key) is not None]
    if curved:
        message = f"makes no straight track at one speed; remove {', '.join(curved)}, and give start_m and length_m"
        problems.append(Problem(f"platform.{curved[0]}", message))
    if len(platform.waypoints_m) > 2:
        message = f"{len(platform.waypoints_m)} points make no straight track; give two, or start_m and length_m"
        problems.append(Problem("platform.waypoints_m", message))
    if problems:
        raise ScenarioError(problems)


class _ImageFormation:
    """The images of a view, formed block by block of pulses."""

    def __init__(self, view: _View) -> None:
        self._view, self._window, self._strip = view, view.settings.processing.window, view.strip
        self._points = tuple(relative_to_track(target, self._strip) for target in view.targets)
        analyser = SpectrumAnalyser(view.chirp, self._window, BINS_PER_CELL, view.high_pass)
        width_m = real_aperture_resolution_m(view.antenna.azimuth, view.strip.slant_range_m(view.strip.near_m))
        self._slar = SideLooking(analyser, max(width_m / STRETCHES_PER_WIDTH, MIN_PULSES * view.spacing_m))
        self._aperture: Aperture | None = None
        self._sar: BackProjection | None = None
        self._patches: dict[int, BackProjection] = {}
        if view.coherent:
            self._aperture = whole_beam(view.antenna)
            self._sar = self._focusing(self._aperture)

    def _focusing(self, aperture: Aperture) -> BackProjection:
        view, chirp = self._view, self._view.chirp
        check_sampling(view.flight.sample(SAMPLED_PULSES).measured, chirp, aperture, view.rate_hz)
        pixels = focused_pixels(self._strip, chirp, aperture, self._window)
        for number, point in enumerate(self._points):
            covered = pixels.along_m[0] <= point.along_m <= pixels.along_m[-1]
            if covered and pixels.across_m[0] <= point.ground_m <= pixels.across_m[-1]:
                patch = patch_around(point, self._strip, self._focused_theory(point, aperture))
                self._patches[number] = self._focused_on(patch, aperture)
        return self._focused_on(pixels, aperture)

    def _focused_on(self, pixels: PixelGrid, aperture: Aperture) -> BackProjection:
        view = self._view
        return BackProjection(view.chirp, pixels, aperture, self._window, view.high_pass, view.rate_hz)

    def add(self, beats: Inexact[np.ndarray, "pulse sample"], measured: Pose) -> None:
        """Add a block of pulses to all images."""
        self._slar.add(beats, measured)
        for image in (self._sar, *self._patches.values()):
            if image is not None:
                image.add(beats, measured)

    def imagery(self) -> Imagery:
        """Return the images of all pulses so far, and their resolution."""
        view, strip = self._view, self._strip
        middle = Point(
            along_m=strip.length_m / 2,
            ground_m=strip.clearance_m * float(np.tan(strip.incidence_rad)),
            height_m=strip.height_m,
            slant_range_m=strip.middle_range_m,
            incidence_rad=strip.incidence_rad,
            steady=True,
        )
        slant = self._slar.image()
        return Imagery(
            scenario=view.settings,
            strip=strip,
            slant=slant,
            focused=self._sar.image() if self._sar else None,
            slar=self._slant_theory(middle),
            sar=self._focused_theory(middle, self._aperture) if self._aperture else None,
            reflectors=tuple(self._reflector(number, slant) for number in range(len(self._points))),
            pulses=len(view.flight),
            georeference=view.georeference,
            recording=view.recording,
        )

    def _reflector(self, number: int, slant: SlantImage) -> Reflector:
        point, theory = self._points[number], self._slant_theory(self._points[number])
        slant_widths = measured_in_slant(slant, point, theory) if self._measurable(point, theory) else None
        focused = None
        if self._aperture is not None and number in self._patches:
            sar_theory, image = self._focused_theory(point, self._aperture), self._patches[number].image()
            measured = measured_in_patch(image.power, image.grid) if self._measurable(point, sar_theory) else None
            focused = Response(theory=sar_theory, measured=measured)
        return Reflector(
            position_m=self._view.targets[number].position_m,
            place=point,
            slar=Response(theory=theory, measured=slant_widths),
            sar=focused,
        )

    def _measurable(self, point: Point, theory: Widths) -> bool:
        return point.steady and isolated(point, self._points, theory)

    def _slant_theory(self, point: Point) -> Widths:
        return Widths(
            along_m=real_aperture_resolution_m(self._view.antenna.azimuth, point.slant_range_m),
            across_m=slant_range_resolution_m(self._view.chirp, self._window),
        )

    def _focused_theory(self, point: Point, aperture: Aperture) -> Widths:
        return Widths(
            along_m=azimuth_resolution_m(aperture, self._view.chirp.wavelength_m),
            across_m=ground_range_resolution_m(self._view.chirp, self._window, point.incidence_rad),
        )


def _strip(prepared: Prepared) -> Strip:
    scan = prepared.flight.scan
    assert isinstance(scan, SideLookingScan)  # checked before the flight was prepared
    ends = np.array([0, len(prepared) - 1])
    return lit_strip(
        prepared.flight.pulses(ends).measured,
        scan.side,
        prepared.plan.flown.altitude_m,
        scan.incidence_rad,
        prepared.instrument.antenna.beamwidths_rad[1],
        prepared.receiver.chirp.max_range_m,
    )
