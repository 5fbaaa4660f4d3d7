"""The estimator of angles of arrival of a scenario."""

import numpy as np

from sionna_radar.detection.angle.arrival import AngleEstimator
from sionna_radar.detection.angle.row import RowEstimator
from sionna_radar.detection.detector import Detector
from sionna_radar.radar.antenna import Antenna, Cut
from sionna_radar.radar.build import build_side_receivers
from sionna_radar.radar.main_lobe import FOLLOWED, lobe_samples
from sionna_radar.scenario.radar import RadarTable


def build_angle_estimator(radar: RadarTable, detector: Detector, antenna: Antenna) -> AngleEstimator | None:
    """Return the estimator of directions inside the beam; None where the scenario requests none.

    Raises ScenarioError for receivers that cannot resolve them; see `build_side_receivers`.
    """
    if detector.processing.angle == "off":
        return None
    spread = two_way_spread(antenna)
    width_az, width_el = antenna.beamwidths_rad
    estimator = RowEstimator if detector.processing.angle == "row" else AngleEstimator
    return estimator(
        detector=detector,
        receivers=build_side_receivers(radar, antenna, spread, detector.analyser.chirp.wavelength_m),
        spread=spread,
        half_power=(float(np.sin(width_az / 2)), float(np.sin(width_el / 2))),
        length_m=detector.processing.angle_length_m,
    )


def two_way_spread(antenna: Antenna) -> tuple[float, float]:
    """Return the standard deviations of the two-way power over the direction cosines in azimuth and in elevation."""
    return _spread(antenna.azimuth), _spread(antenna.elevation)


def _spread(cut: Cut) -> float:
    lobe = lobe_samples(cut, FOLLOWED)
    power, cosine = cut.voltage[lobe] ** 4, cut.cosine[lobe]
    mean = power @ cosine / power.sum()
    return float(np.sqrt(power @ (cosine - mean) ** 2 / power.sum()))
