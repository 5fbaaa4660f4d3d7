"""How a volume moves, estimated from the survey: drops fall, and the wind carries them.

Motion shifts the range measured by an FMCW sweep, so that the end of the volume appears beside the
echo of the ground that ends it. The shift in each pulse depends on the mean velocity of the particles along its
boresight; a scan sees it from many directions. The prior is rain falling through still air, drops weighted by their
echo. Snow, fog or a wind are accepted if they raise the likelihood of all pulses together by more than an error
of the model does: over simulated ground the maximum likelihood is up to 1 m/s off the true speed.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize

from sionna_radar.weather.drops import marshall_palmer
from sionna_radar.weather.rain import echo_speeds

# Rain rate that sets the expected fall speed; at 77 GHz it is 4.1 m/s at 1 mm/h and 4.9 m/s at 25 mm/h.
TYPICAL_RAIN_MM_PER_H = 5.0
TYPICAL_TEMPERATURE_K = 283.0
# Snowflakes fall at 0.8 to 1.5 m/s whatever their size (Locatelli and Hobbs 1974, J. Geophys. Res. 79, 2185).
SNOW_FALL_MPS = 1.1
# Another motion must be likelier than rain in still air by more than this error in radial speed costs,
# and by more nepers per pulse than weak ground causes at random.
MODEL_ERROR_MPS = 1.4
LEAST_GAIN = 0.1
# Standard deviations of the fall about the expected one, and of each horizontal component of the wind.
FALL_SIGMA_MPS = 0.5
WIND_SIGMA_MPS = 5.0
# Relative spread of the fall speed: drops fall at 2 to 7 m/s with a mean of 4.5 m/s.
FALL_SPREAD = 0.22
# Radial speeds at which pulses are compared.
RADIAL_SPEEDS_MPS = np.arange(-10.0, 15.0, 2.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class VolumeMotion:
    """Mean velocity of the volume's particles, in world axes, and the standard deviation of their fall speed."""

    velocity_mps: Float[np.ndarray, " 3"]
    fall_spread_mps: float

    def range_rate_mps(self, boresight: Float[np.ndarray, "pulse 3"]) -> Float[np.ndarray, " pulse"]:
        """Return how fast the volume recedes from a stationary radar."""
        return boresight @ self.velocity_mps


def falling(fall_mps: float) -> VolumeMotion:
    """Return the motion of a volume falling through still air."""
    return VolumeMotion(velocity_mps=np.array([0.0, 0.0, -fall_mps]), fall_spread_mps=FALL_SPREAD * fall_mps)


def expected_motion(carrier_hz: float) -> VolumeMotion:
    """Return the motion of rain in still air, drops weighted by their echo at the carrier."""
    return falling(_rain_fall_mps(carrier_hz))


def estimated_motion(
    carrier_hz: float,
    boresight: Float[np.ndarray, "pulse 3"],
    likelihood: Callable[[float], Float[np.ndarray, " pulse"]],
) -> VolumeMotion:
    """Return the most probable motion.

    Parameters
    ----------
    carrier_hz:
        Carrier, which determines the echo weight of each drop size.
    boresight:
        Boresights of pulses spread over the survey, from their measured poses.
    likelihood:
        Log-likelihood of each pulse for a volume that recedes from all of them at one speed (m/s).

    """
    by_speed = np.array([likelihood(float(speed)) for speed in RADIAL_SPEEDS_MPS])
    spline = CubicSpline(RADIAL_SPEEDS_MPS, by_speed, bc_type="natural")
    row = np.arange(len(boresight))
    reach = RADIAL_SPEEDS_MPS[[0, -1]]

    def cost(velocity_mps: Float[np.ndarray, " 3"], fall_mps: float) -> float:
        """Return the negative log-posterior; each pulse has its own radial speed and spline."""
        speed = np.clip(boresight @ velocity_mps, *reach)
        piece = np.clip(np.searchsorted(RADIAL_SPEEDS_MPS, speed) - 1, 0, len(RADIAL_SPEEDS_MPS) - 2)
        step = speed - RADIAL_SPEEDS_MPS[piece]
        value = sum(c[piece, row] * step ** (3 - power) for power, c in enumerate(spline.c))
        wind = velocity_mps[:2] @ velocity_mps[:2] / WIND_SIGMA_MPS**2
        return float(-np.sum(value) + (wind + ((velocity_mps[2] + fall_mps) / FALL_SIGMA_MPS) ** 2) / 2)

    def fitted(fall_mps: float) -> tuple[float, VolumeMotion]:
        """Return the best wind and fall around an expected fall speed, and their cost."""
        start = np.array([0.0, 0.0, -fall_mps])
        simplex = start + np.concatenate([np.zeros((1, 3)), np.diag([WIND_SIGMA_MPS, WIND_SIGMA_MPS, FALL_SIGMA_MPS])])
        options = {"initial_simplex": simplex, "xatol": 0.01, "fatol": 0.01}
        best = minimize(cost, start, args=(fall_mps,), method="Nelder-Mead", options=options)
        spread_mps = FALL_SPREAD * max(-float(best.x[2]), 0.0)
        return best.fun, VolumeMotion(velocity_mps=best.x, fall_spread_mps=spread_mps)

    falls = (_rain_fall_mps(carrier_hz), SNOW_FALL_MPS, 0.0)
    chosen = falling(falls[0])
    most = cost(chosen.velocity_mps, falls[0]) - max(_loss_by_error(by_speed.sum(axis=1)), LEAST_GAIN * len(boresight))
    still_air = [(cost(falling(fall).velocity_mps, fall), falling(fall)) for fall in falls[1:]]
    for value, motion in still_air + [fitted(fall) for fall in falls]:
        if value < most:
            most, chosen = value, motion
    return chosen


def _loss_by_error(total: Float[np.ndarray, " speed"]) -> float:
    """Return the loss of log-likelihood by an error of the model, from the curvature at the best radial speed."""
    best = int(np.clip(np.argmax(total), 1, len(total) - 2))
    step_mps = RADIAL_SPEEDS_MPS[1] - RADIAL_SPEEDS_MPS[0]
    return float((total[best] - total[[best - 1, best + 1]].mean()) * (MODEL_ERROR_MPS / step_mps) ** 2)


def _rain_fall_mps(carrier_hz: float) -> float:
    speeds = echo_speeds(carrier_hz, drops=marshall_palmer(TYPICAL_RAIN_MM_PER_H), temperature_k=TYPICAL_TEMPERATURE_K)
    return float(np.mean(speeds.at((np.arange(200) + 0.5) / 200)))
