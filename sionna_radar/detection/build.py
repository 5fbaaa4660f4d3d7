"""Builder of the processing of a scenario: detector, range estimator, expected ground, angle of arrival."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sionna_radar.detection.angle.array_arrival import ArrayEstimator
from sionna_radar.detection.angle.arrival import AngleEstimator
from sionna_radar.detection.angle.row import RowEstimator
from sionna_radar.detection.cfar import Cfar
from sionna_radar.detection.detector import RESPONSE_CELLS, SHARED_NOISE, Detector, VolumeOptions
from sionna_radar.detection.expected_ground import ExpectedGround, rough_surface
from sionna_radar.detection.ranging.estimators import RangeEstimator, TrackerRange
from sionna_radar.detection.ranging.plane_fit import beam_profile
from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.raster import Georeference, Grid
from sionna_radar.radar.antenna import Antenna, two_way_spread
from sionna_radar.radar.chirp import Chirp
from sionna_radar.radar.equation import near_field_m, two_way_beam_sr
from sionna_radar.radar.mimo_array import MimoArray
from sionna_radar.scenario.parts import RANGE_ESTIMATORS
from sionna_radar.scenario.processing import ExpectedGroundTable, ProcessingTable, TrackerTable
from sionna_radar.scenario.receiver import ArrayTable
from sionna_radar.scenario.registry import Builder, registers
from sionna_radar.scenario.table import Table
from sionna_radar.signal.analog_filters import HighPass, SampledNoise


def build_angle_estimator(
    processing: ProcessingTable,
    detector: Detector,
    antenna: Antenna,
    array: MimoArray | None,
    frames: ArrayTable | None = None,
) -> AngleEstimator | ArrayEstimator | None:
    """Return the estimator of directions by an array's receivers; None without them.

    frames: `[radar.array]` where a pulse is a frame of an array, which has points in cells of range and range rate.

    Raises ScenarioError for frames behind a range gate.
    """
    if array is None:
        return None
    if frames is not None:
        if detector.analyser.chirp.gate_s:
            message = "is not supported with frames of an array; set 0, or process single chirps of one receiver"
            raise ScenarioError.of("radar.gate_delay_us", message)
        return frames.to(
            ArrayEstimator,
            analyser=replace(detector.analyser, zero_padding=1),
            array=array.calibrated,
            min_range_m=processing.min_range_m,
            false_alarm_probability=processing.cfar.false_alarm_probability,
            dynamic_range_db=processing.dynamic_range_db,
            half_view_rad=float(np.deg2rad(frames.half_view_deg)),
            strongest=processing.echoes != "all",
        )
    width_az, width_el = antenna.beamwidths_rad
    estimator = RowEstimator if processing.angle == "row" else AngleEstimator
    return estimator(
        detector=detector,
        array=array.calibrated,
        spread=two_way_spread(antenna),
        half_power=(float(np.sin(width_az / 2)), float(np.sin(width_el / 2))),
        length_m=processing.angle_length_m,
    )


@registers(RANGE_ESTIMATORS, "[processing.ranging_parameters]")
def register_range_estimator(name: str, parameters: type[Table] | None = None) -> Callable[[Builder], Builder]:
    """Register a range estimator, for `processing.ranging` in a scenario.

    Decorates a class or function that builds a `RangeEstimator`, called with the parameters, if any.

    Examples
    --------
    >>> from sionna_radar.detection import Ranges
    >>> @register_range_estimator("nearest_bin")
    ... class NearestBin:
    ...     def __call__(self, spans):
    ...         return Ranges(range_m=spans.start * spans.bin_m, sigma_m=0.0 * spans.start + spans.bin_m)
    >>> load_scenario("hills", {"processing.ranging": "nearest_bin"}).processing.ranging
    'nearest_bin'
    """
    return RANGE_ESTIMATORS.register(name, parameters)


def build_range_estimator(table: ProcessingTable) -> RangeEstimator:
    """Return the range estimator of a scenario."""
    return RANGE_ESTIMATORS.build(table.ranging, RangeEstimator, table.ranging_parameters)


def tracker_range(table: TrackerTable) -> TrackerRange:
    """Return the estimator of a tracker."""
    follows = RANGE_ESTIMATORS.build(table.follows, RangeEstimator, None)
    return TrackerRange(follows=follows, time_constant_s=table.time_constant_s)


def build_detector(
    processing: ProcessingTable,
    chirp: Chirp,
    antenna: Antenna | None = None,
    high_pass: HighPass | None = None,
    estimator: RangeEstimator | None = None,
    *,
    noise: SampledNoise | None = None,
    speckle_looks: int = 1,
    transmit_power_w: float | None = None,
    reports_obstacles: bool = False,
) -> Detector:
    """Return the processing of a scenario.

    processing, chirp: the processing and the sweep it is for.
    antenna: the antenna, for estimators that model the beam.
    high_pass: high-pass of the receiver, which the calibration removes from the spectra.
    estimator: a range estimator in place of that of `processing`.
    noise: of the receiver's samples behind its high-pass; None where it is not known.
    speckle_looks: number of averaged powers in a pulse with independent speckle.
    transmit_power_w: transmitted power, where beat signals are on its scale: the strength of a volume's echo then gives
        the rain.
    reports_obstacles: whether echoes in front of the ground are needed, too, where there is a volume.

    Raises ScenarioError if the window leaks the cell under test into the training cells.
    """
    analyser = SpectrumAnalyser(
        chirp, processing.window, processing.zero_padding, high_pass, processing.average.powers, noise
    )
    table = processing.cfar
    guard, training = table.sides(chirp.range_cells)
    correlation = analyser.noise_correlation(guard + training + 1)
    shared = np.flatnonzero(correlation**2 > SHARED_NOISE)
    if guard < shared[-1]:
        message = f"{guard} cells; the window {processing.window!r} needs at least {shared[-1]}; raise it"
        raise ScenarioError.of("processing.cfar.guard", message)
    cfar = table.to(
        Cfar,
        guard=guard,
        training=training,
        stride=processing.zero_padding,
        correlation=correlation,
        looks=processing.average.powers,
    )
    response = analyser.response(RESPONSE_CELLS * processing.zero_padding, processing.zero_padding)
    return processing.to(
        Detector,
        analyser=analyser,
        cfar=cfar,
        kept=processing.echoes,
        volume=processing.volume.to(VolumeOptions),
        behind_volume="all" if reports_obstacles and processing.echoes == "all" else "ground",
        estimator=estimator or build_range_estimator(processing),
        beam=None if antenna is None else beam_profile(antenna, response),
        speckle_looks=speckle_looks,
        volume_echo_w=_volume_echo_w(antenna, analyser, transmit_power_w),
        near_field_m=0.0 if antenna is None else near_field_m(antenna, analyser.chirp.wavelength_m),
    )


def _volume_echo_w(antenna: Antenna | None, analyser: SpectrumAnalyser, transmit_power_w: float | None) -> float | None:
    """Return the mean power (W) in a range cell at one metre of a volume that fills the beam, of reflectivity one.

    P = P_t G0^2 lambda^2 Omega_2 dr / (4 pi)^3, see `rain_clutter_power`, times the noise bandwidth of the window in
    cells. None for ports that part of the echo of drops reaches, which depends on their shapes.
    """
    if antenna is None or transmit_power_w is None or antenna.circular or antenna.receives != "co":
        return None
    chirp, window = analyser.chirp, analyser.window
    aperture = antenna.peak_gain**2 * chirp.wavelength_m**2 * two_way_beam_sr(antenna) / (4 * np.pi) ** 3
    bandwidth_cells = len(window) * float(np.sum(window**2)) / float(np.sum(window)) ** 2
    return float(transmit_power_w * aperture * chirp.range_resolution_m * bandwidth_cells)


def build_expected_ground(
    table: ExpectedGroundTable | None, altitude_m: float, antenna: Antenna, grid: Grid, place: Georeference | None
) -> ExpectedGround | None:
    """Return the expected ground of a scenario; None if it has none.

    table: `[processing.expected_ground]`.
    altitude_m: nominal height of the flight above ground.
    antenna: the antenna, for its beam width.
    grid: cells of the survey's DEM.
    place: georeference of the local frame, if it has one.

    Raises InputFileError if the rough DEM cannot be read, or does not overlap the survey.
    Raises ScenarioError if only one of the rough DEM and the terrain is georeferenced.
    """
    if table is None:
        return None
    azimuth, elevation = antenna.beamwidths_rad
    return ExpectedGround(
        surface=None if table.path is None else rough_surface(table.path, grid, place),
        altitude_m=altitude_m,
        tolerance_m=table.tolerance_m,
        half_beam_rad=(azimuth, elevation),
    )
