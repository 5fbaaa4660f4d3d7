"""The instrument of a survey: what the radar is, wherever it flies."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sionna_radar.detection.angle.array_arrival import ArrayEstimator
from sionna_radar.detection.angle.arrival import AngleEstimator
from sionna_radar.detection.build import build_angle_estimator, build_detector
from sionna_radar.detection.detector import Detector
from sionna_radar.flight.build import build_scan
from sionna_radar.flight.scan import Scan
from sionna_radar.foundation.build_cache import BuildCache
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.array_antenna import beams_of
from sionna_radar.radar.build import (
    build_antenna,
    build_array,
    build_receivers,
    build_sweeps,
    squinting,
    warn_of_frequency,
)
from sionna_radar.radar.chirp import Chirp
from sionna_radar.radar.mimo_array import MimoArray
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.processing import ProcessingTable
from sionna_radar.scenario.radar import speckle_looks
from sionna_radar.scenario.receiver import ArrayTable
from sionna_radar.signal.analog_filters import HighPass
from sionna_radar.signal.build import build_high_pass, build_sampled_noise, transmit_power_w
from sionna_radar.survey.custom_parts import CustomParts
from sionna_radar.survey.obstacles import reports_obstacles

# Samples times zero-padding: the length of the Fourier transform of a chirp.
MAX_SPECTRUM = 2**18
# Most powers that an ordered-statistic CFAR sorts per spectrum.
MAX_RANKED = 4_000_000
# Beyond this, float32 rays and millimetre point clouds lose precision, m.
FARTHEST_M = 100_000.0
# Largest phase error of a point over a chirp beyond uniform motion, rad.
MAX_BEND_RAD = 0.5


@dataclass(frozen=True, kw_only=True)
class Instrument:
    """A radar and the processing of its echoes; the noise of its receiver counts from the ground, see `Prepared`.

    sweeps: of one pulse, as transmitted: a single one, or the two halves of a triangle.
    transmit_power_w: transmitted power; 1 where the scenario gives a signal-to-noise ratio instead.
    pulse_rate_hz: chirps, or frames of an array, a second, without pauses; mean_rate_hz: averaged ones, with pauses.
    scan: where the antenna points.
    antenna: its pattern; beams: the antenna steered to each beam of an electronic scan.
    high_pass: of the receiver; None for one without.
    module: the array with its true errors; None for a radar of which one receiver is used.
    frames: the table of the array of which a pulse is a frame; None for pulses that are chirps.
    detector: from beat signals to echoes.
    angle: finds directions inside the beam, or points in the frames of an array; None for echoes on the beam's axis.
    """

    sweeps: tuple[Chirp, ...]
    transmit_power_w: float
    pulse_rate_hz: float
    mean_rate_hz: float
    scan: Scan
    antenna: Antenna
    beams: tuple[Antenna, ...] = ()
    high_pass: HighPass | None = None
    module: MimoArray | None = None
    frames: ArrayTable | None = None
    detector: Detector
    angle: AngleEstimator | ArrayEstimator | None = None

    @property
    def chirp(self) -> Chirp:
        """The first sweep of a pulse."""
        return self.sweeps[0]


def build_instrument(local: Scenario, custom: CustomParts, cache: BuildCache) -> Instrument:
    """Return the instrument; ScenarioError if it is too large, or cannot show the scenario's vegetation or rotors."""
    radar, processing = local.radar, local.processing
    if processing.calibration is not None:
        message = "is of recordings; give the errors of a simulated flight as platform.navigation, and leave this out"
        raise ScenarioError.of("processing.calibration", message)
    high_pass, transmitted_w = build_high_pass(radar.receiver), transmit_power_w(radar)
    scan = custom.scan or build_scan(radar.scan)
    antenna = custom.antenna or build_antenna(radar.antenna, cache)
    if custom.antenna is None:
        warn_of_frequency(radar.antenna, radar.carrier_hz)
    antenna, sweeps = squinting(radar.antenna, antenna, build_sweeps(radar))
    chirp, period_s = sweeps[0], 1 / radar.chirp_rate_hz
    frames = radar.array if local.sensor == "mimo" else None
    rate_hz = radar.chirp_rate_hz if frames is None else frames.frame_rate_hz
    module = None
    if frames is not None:
        module = build_array(frames, chirp, period_s, local.seed)
    elif processing.angle != "off":
        module = build_receivers(radar.second_receiver, antenna, chirp, period_s)
    if local.vegetation and (antenna.circular or antenna.receives != "co"):
        message = "the echo of [[vegetation]] is modelled for linear co-polar antennas only; set 'V' or 'H', and 'co'"
        raise ScenarioError.of("radar.antenna.polarization", message)
    _check_rotors(local, chirp)
    if problems := [*_sweep_limits(chirp), *processing_limits(processing, chirp)]:
        raise ScenarioError(problems)
    detector = build_detector(
        processing,
        chirp,
        antenna,
        high_pass,
        custom.range_estimator,
        noise=build_sampled_noise(radar, sweeps),
        speckle_looks=speckle_looks(processing, local.tracing),
        transmit_power_w=transmitted_w,
        reports_obstacles=reports_obstacles(local),
    )
    return Instrument(
        sweeps=sweeps,
        transmit_power_w=transmitted_w,
        pulse_rate_hz=rate_hz,
        mean_rate_hz=rate_hz / (1 + radar.stagger / 2) / processing.average.chirps,
        scan=scan,
        antenna=antenna,
        beams=beams_of(antenna, scan),
        high_pass=high_pass,
        module=module,
        frames=frames,
        detector=detector,
        angle=build_angle_estimator(processing, detector, antenna, module, frames),
    )


def _check_rotors(scenario: Scenario, chirp: Chirp) -> None:
    """Raise ScenarioError for rotors whose blades do not move uniformly during a chirp.

    The residual phase at the ends of the chirp is 4 pi / wavelength times half the acceleration times the square of
    half the duration.
    """
    problems = []
    for number, target in enumerate(scenario.targets):
        for index, rotor in enumerate(target.rotors):
            acceleration = (2 * np.pi * rotor.rotation_rpm / 60) ** 2 * rotor.radius_m
            bend_rad = np.pi / (2 * chirp.wavelength_m) * acceleration * chirp.duration_s**2
            if bend_rad > MAX_BEND_RAD:
                needed_hz = chirp.rate_hz * np.sqrt(bend_rad / MAX_BEND_RAD)
                message = (
                    f"{rotor.rotation_rpm:g} bends the echo of its tips by {bend_rad:.3g} rad in a chirp; lower it, or "
                    f"raise radar.chirp_rate_hz to {needed_hz:.3g} or more"
                )
                problems.append(Problem(f"targets.{number}.rotors.{index}.rotation_rpm", message))
    if problems:
        raise ScenarioError(problems)


def processing_limits(processing: ProcessingTable, chirp: Chirp) -> Iterator[Problem]:
    """Yield the problems of too long spectra, too many ranked cells, and ranges that are all too near."""
    samples = chirp.samples
    bins = samples * processing.zero_padding
    if bins > MAX_SPECTRUM:
        message = (
            f"{processing.zero_padding} times {samples:,} samples make spectra of {bins:,} bins, more than "
            f"{MAX_SPECTRUM:,}; lower it to {MAX_SPECTRUM // samples}, or radar.samples_per_chirp"
        )
        yield Problem("processing.zero_padding", message)
    cfar = processing.cfar
    tested = bins // (2 if chirp.sampling == "real" else 1)
    _, training = cfar.sides(chirp.range_cells)
    if cfar.kind == "OS" and 2 * training * tested > MAX_RANKED:
        message = (
            f"{training} cells on each side of {tested:,} bins are too many to sort; "
            f"lower it to {max(1, MAX_RANKED // (2 * tested))}, or set processing.cfar.kind = 'CA'"
        )
        yield Problem("processing.cfar.training", message)
    # The detector tests cells from the nearest range on, and not the last one.
    nearest_m, last_m = processing.min_range_m, chirp.max_range_m - 2 * chirp.range_resolution_m
    if nearest_m > last_m:
        message = f"{nearest_m:g} m is beyond the last tested range cell, at {last_m:.4g} m; lower it"
        yield Problem("processing.min_range_m", message)


def _sweep_limits(chirp: Chirp) -> Iterator[Problem]:
    """Yield the problem of a sweep that reaches too far."""
    if chirp.max_range_m > FARTHEST_M:
        message = (
            f"{chirp.bandwidth_hz:g} and {chirp.samples} samples reach {chirp.max_range_m:.3g} m, farther than "
            f"{FARTHEST_M:g}; raise it to {1.01 * chirp.bandwidth_hz * chirp.max_range_m / FARTHEST_M:.3g}"
        )
        yield Problem("radar.bandwidth_hz", message)
