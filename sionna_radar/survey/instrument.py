"""The instrument of a survey: what the radar is, wherever it flies."""

from dataclasses import dataclass

from sionna_radar.detection.angle.array_arrival import ArrayEstimator
from sionna_radar.detection.angle.arrival import AngleEstimator
from sionna_radar.detection.build import build_angle_estimator, build_detector
from sionna_radar.detection.detector import Detector
from sionna_radar.flight.build import build_scan
from sionna_radar.flight.scan import Scan
from sionna_radar.foundation.build_cache import BuildCache
from sionna_radar.foundation.errors import ScenarioError
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
from sionna_radar.scenario.radar import speckle_looks
from sionna_radar.scenario.receiver import ArrayTable
from sionna_radar.signal.analog_filters import HighPass
from sionna_radar.signal.build import build_high_pass, transmit_power_w
from sionna_radar.survey.checks import check_rotors, check_vegetation
from sionna_radar.survey.custom_parts import CustomParts
from sionna_radar.survey.limits import check_instrument


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
    """Return the instrument of a scenario.

    Raises ScenarioError for a radar that does not fit into memory, or cannot show the scenario's vegetation or rotors.
    """
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
    check_vegetation(local, antenna)
    check_rotors(local, chirp)
    check_instrument(processing, chirp)
    detector = build_detector(
        processing,
        chirp,
        antenna,
        high_pass,
        custom.range_estimator,
        speckle_looks=speckle_looks(processing, local.tracing),
        transmit_power_w=transmitted_w,
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
