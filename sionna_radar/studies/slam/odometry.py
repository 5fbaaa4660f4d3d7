"""Odometer and gyroscope: how far a vehicle drove, and how far it turned, from turn to turn.

Samples are integrated between the middles of successive turns (preintegration: Lupton and Sukkarieh 2012, IEEE
Transactions on Robotics 28, 61). An odometer reads (1 + s) v with an unknown scale s, a gyroscope w + b with an unknown
bias b; both are states of the drive. Noise is white from sample to sample.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.integrate import cumulative_trapezoid

from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import regular_file, shown
from sionna_radar.studies.panorama.polar_images import PolarImages
from sionna_radar.studies.slam.surfaces import rotation

TIME, SPEED, YAW_RATE = "time_s", "speed_mps", "yaw_rate_rad_s"
REMEDY = f"give columns {TIME} and {SPEED}, {YAW_RATE} or both, with increasing times"
MAX_BYTES = 1_000_000_000
# Greatest speed (m/s) and yaw rate (rad/s) of a vehicle; more is another unit, or a fault.
MAX_RATES = {SPEED: 150.0, YAW_RATE: 50.0}
# What is known before of the scale of a wheel's radius, and of the bias of a MEMS gyroscope (0.5 deg/s).
ODOMETER_SIGMA = np.array([0.02, float(np.deg2rad(0.5))])


@dataclass(frozen=True, kw_only=True)
class Increments:
    """Way and angle between successive turns, with standard deviations; NaN where not measured.

    way_m: driven. turn_rad: clockwise.
    """

    time_s: Float[np.ndarray, " step"]
    way_m: Float[np.ndarray, " step"]
    way_sigma_m: float
    turn_rad: Float[np.ndarray, " step"]
    turn_sigma_rad: float

    def factor(
        self,
        step: int,
        before: Float[np.ndarray, " 6"],
        after: Float[np.ndarray, " 6"],
        odometer: Float[np.ndarray, " 2"],
    ) -> tuple[Float[np.ndarray, "14 14"], Float[np.ndarray, " 14"]]:
        """Return information and gradient with respect to two successive states, the scale and the bias."""
        between = after[:2] - before[:2]
        turn = np.mod(after[2] - before[2] + np.pi, 2 * np.pi) - np.pi
        ahead = rotation(before[2] + turn / 2)[:, 0]
        # A chord of the circle is shorter than the way.
        longer = (1 + odometer[0]) / np.sinc(turn / (2 * np.pi))
        J, e, W = np.zeros((2, 14)), np.zeros(2), np.zeros(2)
        if np.isfinite(self.way_m[step]):
            W[0], e[0] = self.way_sigma_m**-2, longer * (ahead @ between) - self.way_m[step]
            J[0, 6:8] = longer * ahead
            J[0, :2], J[0, 12] = -J[0, 6:8], ahead @ between
        if np.isfinite(self.turn_rad[step]):
            W[1] = self.turn_sigma_rad**-2
            e[1] = turn + odometer[1] * self.time_s[step] - self.turn_rad[step]
            J[1, 2], J[1, 8], J[1, 13] = -1.0, 1.0, self.time_s[step]
        return J.T @ (W[:, None] * J), J.T @ (W * e)


@dataclass(frozen=True, kw_only=True)
class Odometry:
    """Samples of an odometer, a gyroscope, or both.

    speed_mps: ahead; yaw_rate_rad_s: clockwise; None where there is no such sensor.
    speed_sigma_mps, yaw_rate_sigma_rad_s: white noise of a sample.
    """

    time_s: Float[np.ndarray, " sample"]
    speed_mps: Float[np.ndarray, " sample"] | None = None
    yaw_rate_rad_s: Float[np.ndarray, " sample"] | None = None
    speed_sigma_mps: float = 0.1
    yaw_rate_sigma_rad_s: float = float(np.deg2rad(0.2))

    def between(self, middle_s: Float[np.ndarray, " turn"]) -> Increments:
        """Return the increments between times; raises InputFileError if the samples do not span them."""
        if self.time_s[0] > middle_s[0] or self.time_s[-1] < middle_s[-1]:
            raise InputFileError(
                f"odometry from {self.time_s[0]:.3f} to {self.time_s[-1]:.3f} s does not span the turns, "
                f"{middle_s[0]:.3f} to {middle_s[-1]:.3f} s; give one that does, of the same clock"
            )
        step_s = np.diff(middle_s)
        # The integral over a step of n samples of white noise has the standard deviation sigma T / sqrt(n).
        spread_s = float(np.sqrt(np.median(step_s) * np.median(np.diff(self.time_s))))
        return Increments(
            time_s=step_s,
            way_m=self._integrated(self.speed_mps, middle_s),
            way_sigma_m=self.speed_sigma_mps * spread_s,
            turn_rad=self._integrated(self.yaw_rate_rad_s, middle_s),
            turn_sigma_rad=self.yaw_rate_sigma_rad_s * spread_s,
        )

    def _integrated(
        self, rate: Float[np.ndarray, " sample"] | None, middle_s: Float[np.ndarray, " turn"]
    ) -> Float[np.ndarray, " step"]:
        if rate is None:
            return np.full(len(middle_s) - 1, np.nan)
        return np.diff(np.interp(middle_s, self.time_s, cumulative_trapezoid(rate, self.time_s, initial=0.0)))


def read_odometry(path: Path, *, speed_sigma_mps: float, yaw_rate_sigma_rad_s: float) -> Odometry:
    """Return the odometry of a CSV file; raises InputFileError for one without its columns, or with other values."""
    regular_file(path, "odometry", REMEDY, MAX_BYTES)
    try:
        lines = path.read_text(encoding="utf-8-sig").split("\n")
        if not lines[0].strip():
            raise ValueError("no header")
        table = np.genfromtxt([*lines, ""], delimiter=",", names=True, dtype=float, ndmin=1)
    except (OSError, ValueError) as error:
        raise InputFileError(f"{shown(path)}: not readable as odometry ({error}); {REMEDY}") from error
    names = table.dtype.names or ()
    if TIME not in names or not {SPEED, YAW_RATE} & set(names):
        raise InputFileError(f"{shown(path)}: its columns are {', '.join(names) or 'none'}; {REMEDY}")
    columns = [table[name] for name in (TIME, SPEED, YAW_RATE) if name in names]
    if len(table) < 2 or not np.all(np.isfinite(columns)) or not np.all(np.diff(table[TIME]) > 0):
        raise InputFileError(f"{shown(path)}: values are missing, or times do not increase; {REMEDY}")
    for name in names:
        if name in MAX_RATES and (greatest := float(np.abs(table[name]).max())) > MAX_RATES[name]:
            message = f"{name} reaches {greatest:.3g}, more than {MAX_RATES[name]:g}; give it in m/s or rad/s"
            raise InputFileError(f"{shown(path)}: {message}, without samples that are no measurements")
    return Odometry(
        time_s=table[TIME],
        speed_mps=table[SPEED] if SPEED in names else None,
        yaw_rate_rad_s=table[YAW_RATE] if YAW_RATE in names else None,
        speed_sigma_mps=speed_sigma_mps,
        yaw_rate_sigma_rad_s=yaw_rate_sigma_rad_s,
    )


def measured_odometry(images: PolarImages, *, speed_sigma_mps: float, yaw_rate_sigma_rad_s: float) -> Odometry:
    """Return the speed and yaw rate that the navigation system of a recording measured, a sample a chirp."""
    if images.measured is None:
        raise InputFileError("the recording has no measured poses; give a CSV file as odometry")
    way, time_s = images.measured, images.time_s.ravel()
    heading = np.unwrap((way.bearing_rad - images.scan_rad).ravel())
    east, north = way.velocity_mps.reshape(-1, 3)[:, :2].T
    return Odometry(
        time_s=time_s,
        speed_mps=east * np.sin(heading) + north * np.cos(heading),
        yaw_rate_rad_s=np.gradient(heading, time_s),
        speed_sigma_mps=speed_sigma_mps,
        yaw_rate_sigma_rad_s=yaw_rate_sigma_rad_s,
    )
