"""A side-looking survey and its images: the slant-range image, and the focused one where the survey is coherent.

Imaging uses the measured pose and the nominal altitude only. The scene's point targets serve to measure the
resolution, like corner reflectors.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Inexact

from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.execution.execution import Execution
from sionna_radar.flight.pulses import Pose
from sionna_radar.flight.scan import SideLookingScan
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.progress import advance, stage
from sionna_radar.foundation.raster import Georeference
from sionna_radar.imaging.aperture import Aperture, PixelGrid, check_sampling, whole_beam
from sionna_radar.imaging.point_response import (
    Point,
    Widths,
    isolated,
    measured_in_patch,
    measured_in_slant,
    patch_around,
    point_beside,
)
from sionna_radar.imaging.sar import BackProjection, SarImage
from sionna_radar.imaging.slar import SideLooking, SlantImage
from sionna_radar.imaging.strip import (
    Strip,
    azimuth_resolution_m,
    focused_pixels,
    ground_range_resolution_m,
    lit_strip,
    real_aperture_resolution_m,
    slant_range_resolution_m,
)
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.radar import refuse_average
from sionna_radar.survey.checks import SAMPLED_PULSES
from sionna_radar.survey.preparation import Prepared, prepare
from sionna_radar.survey.sensors.radar import Radar

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
    """The images of a survey, with their scenario.

    slar, sar: theoretical half-power widths in the middle of the beam; `sar` and `focused` are None without coherence
        from pulse to pulse.
    slant, focused: the images; reflectors: the scene's point targets in them.

    Examples
    --------
    >>> scenario = load_scenario("slar", {"tracing.speckle": "per_pulse", "platform.length_m": 4.0})
    >>> imagery = run_images(scenario)
    >>> imagery.focused is None
    True

    """

    scenario: Scenario
    strip: Strip
    slant: SlantImage
    focused: SarImage | None
    slar: Widths
    sar: Widths | None
    reflectors: tuple[Reflector, ...]
    pulses: int
    georeference: Georeference | None

    def __repr__(self) -> str:
        size = f"{self.slar.along_m:.3g} m x {self.slar.across_m:.3g} m in slant range"
        lines = [f"Imagery: {self.scenario.description or 'no description'}", f"  {self.pulses:,} pulses; SLAR {size}"]
        if self.sar:
            lines.append(f"  SAR {self.sar.along_m:.3g} m x {self.sar.across_m:.3g} m on the ground")
        return "\n".join(lines)


def run_images(scenario: Scenario, *, execution: Execution | None = None) -> Imagery:
    """Fly a side-looking survey and return its images.

    Parameters
    ----------
    scenario:
        The survey; `tracing.speckle = "persistent"` makes it coherent for focusing.
    execution:
        As for `sionna_radar.run`.

    Raises
    ------
    ScenarioError, InputFileError
        The radar does not look to the side of one straight track; the track is shorter than the aperture; the chirp
        rate does not sample the phase along it; or the scenario cannot be flown, see `prepare`.

    Examples
    --------
    >>> scenario = load_scenario("slar", {"tracing.speckle": "per_pulse", "platform.length_m": 4.0})
    >>> run_images(scenario).slar.across_m < 1.0
    True

    """
    _check(scenario)
    execution = execution or Execution()
    with execution.reported():
        prepared = prepare(scenario)
        formation = _ImageFormation(prepared)
        radar = Radar(prepared.sensor_inputs())
        with stage("imaging", len(prepared)):
            for pulses in prepared.flight.blocks(execution.block_size):
                formation.add(radar.beat(pulses), pulses.measured)
                advance(len(pulses))
        return formation.imagery()


def _check(scenario: Scenario) -> None:
    refuse_average(scenario.processing, "an image")
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
    """The images of a prepared survey, formed block by block of pulses."""

    def __init__(self, prepared: Prepared) -> None:
        self._prepared, self._window = prepared, prepared.local.processing.window
        self._strip = _strip(prepared)
        self._points = tuple(point_beside(target, self._strip) for target in prepared.scene.scene.targets)
        analyser = SpectrumAnalyser(prepared.receiver.chirp, self._window, BINS_PER_CELL, prepared.receiver.high_pass)
        self._slar = SideLooking(analyser, _stretch_m(prepared, self._strip))
        self._aperture: Aperture | None = None
        self._sar: BackProjection | None = None
        self._patches: dict[int, BackProjection] = {}
        if prepared.local.tracing.speckle == "persistent":
            self._aperture = whole_beam(prepared.antenna)
            self._sar = self._focusing(self._aperture)

    def _focusing(self, aperture: Aperture) -> BackProjection:
        prepared, chirp = self._prepared, self._prepared.receiver.chirp
        check_sampling(prepared.flight.sample(SAMPLED_PULSES).measured, chirp, aperture)
        pixels = focused_pixels(self._strip, chirp, aperture, self._window)
        for number, point in enumerate(self._points):
            covered = pixels.along_m[0] <= point.along_m <= pixels.along_m[-1]
            if covered and pixels.across_m[0] <= point.ground_m <= pixels.across_m[-1]:
                patch = patch_around(point, self._strip, self._focused_theory(point, aperture))
                self._patches[number] = self._focused_on(patch, aperture)
        return self._focused_on(pixels, aperture)

    def _focused_on(self, pixels: PixelGrid, aperture: Aperture) -> BackProjection:
        receiver = self._prepared.receiver
        return BackProjection(receiver.chirp, pixels, aperture, self._window, receiver.high_pass)

    def add(self, beats: Inexact[np.ndarray, "pulse sample"], measured: Pose) -> None:
        self._slar.add(beats, measured)
        for image in (self._sar, *self._patches.values()):
            if image is not None:
                image.add(beats, measured)

    def imagery(self) -> Imagery:
        """Return the images of all pulses so far, and their resolution."""
        prepared, strip = self._prepared, self._strip
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
            scenario=prepared.scenario,
            strip=strip,
            slant=slant,
            focused=self._sar.image() if self._sar else None,
            slar=self._slant_theory(middle),
            sar=self._focused_theory(middle, self._aperture) if self._aperture else None,
            reflectors=tuple(self._reflector(number, slant) for number in range(len(self._points))),
            pulses=len(prepared),
            georeference=prepared.scene.scene.georeference,
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
            position_m=self._prepared.scene.scene.targets[number].position_m,
            place=point,
            slar=Response(theory=theory, measured=slant_widths),
            sar=focused,
        )

    def _measurable(self, point: Point, theory: Widths) -> bool:
        return point.steady and isolated(point, self._points, theory)

    def _slant_theory(self, point: Point) -> Widths:
        return Widths(
            along_m=real_aperture_resolution_m(self._prepared.antenna.azimuth, point.slant_range_m),
            across_m=slant_range_resolution_m(self._prepared.receiver.chirp, self._window),
        )

    def _focused_theory(self, point: Point, aperture: Aperture) -> Widths:
        return Widths(
            along_m=azimuth_resolution_m(aperture, self._prepared.receiver.chirp.wavelength_m),
            across_m=ground_range_resolution_m(self._prepared.receiver.chirp, self._window, point.incidence_rad),
        )


def _strip(prepared: Prepared) -> Strip:
    scan = prepared.flight.scan
    assert isinstance(scan, SideLookingScan)  # checked before the flight was prepared
    ends = np.array([0, len(prepared) - 1])
    return lit_strip(
        prepared.flight.pulses(ends).measured,
        scan.side,
        prepared.flown.altitude_m,
        scan.incidence_rad,
        prepared.antenna.beamwidths_rad[1],
        prepared.receiver.chirp.max_range_m,
    )


def _stretch_m(prepared: Prepared, strip: Strip) -> float:
    """Return the averaging interval of the slant-range image along the track."""
    width = real_aperture_resolution_m(prepared.antenna.azimuth, strip.slant_range_m(strip.near_m))
    spacing = prepared.flown.speed_mps / prepared.local.radar.chirp_rate_hz
    return max(width / STRETCHES_PER_WIDTH, MIN_PULSES * spacing)
