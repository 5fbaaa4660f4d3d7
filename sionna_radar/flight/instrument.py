"""Constant errors of an instrument (mounting, lever arm, range, clock), and poses and ranges corrected for them.

The navigation system reports a pose by a mounting, a lever arm and a clock that are believed; each may err. An error is
what is believed minus what is true, in the signs of `platform.navigation`:

- mounting: the antenna's mount is believed to be turned by it about nose, right and down;
- squint: the beam is believed to be turned by it about the antenna's upward axis;
- lever arm: believed to be longer by it (nose, right, down);
- time offset: lag of the report behind the radar's clock;
- range: read = (1 + scale) true + bias;
- datum: the position (east, north, up) minus that in the datum of what it is compared with;
- velocity: believed to be greater by it (east, north, up);
- backscatter slope: derivative of the logarithm of sigma0 over the cosine of incidence, with incidence, which is
  believed to be zero. It is one of the ground, and turns the direction that an echo's power comes from.

With B the believed axes of the body (the antenna's orientation without its scan), w the turn rate, a the acceleration
and R() rotations by rotation vectors, the true antenna is at

    p + v dt + a dt^2 / 2 - B' l,   v + a dt - w x B' l - dv,   B' = R(w dt) B R(-m),   axes B' S R(-s),

S being the antenna's axes in its mount. Lever arm and time offset are the same along the track at constant speed and
attitude, as are mounting and attitude biases everywhere (Skaloud and Lichti 2006, "Rigorous approach to bore-sight
self-calibration in airborne laser scanning", ISPRS Journal 61).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from sionna_radar.flight.frames import Vector3, world_from_level
from sionna_radar.flight.pulses import Pose, Pulses
from sionna_radar.flight.scan import Scan
from sionna_radar.foundation.columns import Columns

ZERO: Vector3 = (0.0, 0.0, 0.0)
# Half of the time over which turn rate and acceleration are differences of poses: white errors of the attitude of
# 0.01 deg then pass for 0.07 deg/s, which moves a pose by 0.0004 deg in 5 ms.
HALF_STEP_S = 0.1
# Pulses this near to the end of a line may be reported with the pose of a turn.
ENDS_S = 0.05
# A change of the velocity from one pulse to the next, as a share of it, that is an instantaneous turn: none of an
# aircraft is, but planned flights have them.
INSTANTANEOUS = 0.3
# Pause between pulses that parts one flight line from the next, s.
LINE_GAP_S = 1.0
# Stretches of a flight that are compared, at most, and the pulses in each at least.
STRETCHES, MIN_STRETCH = 48, 24
WAYS = ("east", "north", "up")
SIDES = ("nose", "right", "down")
ANGLES = ("roll", "pitch", "heading")


@dataclass(frozen=True, kw_only=True)
class Unknown:
    """An error that can be estimated.

    unit, si: unit of statements, and one of it in SI units; prior: standard deviation beforehand, in that unit, of an
    instrument that was mounted with a tape, a bubble and the delays of its data sheet.
    """

    unit: str
    si: float
    prior: float


DEGREE, MILLI, PPM, DECIBEL = float(np.deg2rad(1.0)), 1e-3, 1e-6, float(np.log(10.0) / 10)
UNKNOWNS: dict[str, Unknown] = {
    "roll": Unknown(unit="deg", si=DEGREE, prior=1.0),
    "pitch": Unknown(unit="deg", si=DEGREE, prior=1.0),
    "heading": Unknown(unit="deg", si=DEGREE, prior=1.0),
    "squint": Unknown(unit="deg", si=DEGREE, prior=1.0),
    "lever_nose": Unknown(unit="m", si=1.0, prior=0.1),
    "lever_right": Unknown(unit="m", si=1.0, prior=0.1),
    "lever_down": Unknown(unit="m", si=1.0, prior=0.1),
    "range_bias": Unknown(unit="m", si=1.0, prior=1.0),
    "range_scale": Unknown(unit="ppm", si=PPM, prior=1000.0),
    "time_offset": Unknown(unit="ms", si=MILLI, prior=20.0),
    "datum_east": Unknown(unit="m", si=1.0, prior=5.0),
    "datum_north": Unknown(unit="m", si=1.0, prior=5.0),
    "datum_up": Unknown(unit="m", si=1.0, prior=5.0),
    "velocity_east": Unknown(unit="m/s", si=1.0, prior=0.02),
    "velocity_north": Unknown(unit="m/s", si=1.0, prior=0.02),
    "velocity_up": Unknown(unit="m/s", si=1.0, prior=0.02),
    "backscatter_slope": Unknown(unit="dB/deg", si=DECIBEL / DEGREE, prior=0.1),
}


@dataclass(frozen=True, kw_only=True)
class InstrumentErrors:
    """Constant errors of an instrument, believed minus true, in SI units and radians; see above."""

    mounting_rad: Vector3 = ZERO
    squint_rad: float = 0.0
    lever_arm_m: Vector3 = ZERO
    range_bias_m: float = 0.0
    range_scale: float = 0.0
    time_offset_s: float = 0.0
    datum_m: Vector3 = ZERO
    velocity_mps: Vector3 = ZERO
    backscatter_slope: float = 0.0

    @classmethod
    def of(cls, values: dict[str, float]) -> "InstrumentErrors":
        """Return the errors of given values by the names in `UNKNOWNS`, SI; others are zero."""
        at = {name: values.get(name, 0.0) for name in UNKNOWNS}
        return cls(
            mounting_rad=(at["roll"], at["pitch"], at["heading"]),
            squint_rad=at["squint"],
            lever_arm_m=(at["lever_nose"], at["lever_right"], at["lever_down"]),
            range_bias_m=at["range_bias"],
            range_scale=at["range_scale"],
            time_offset_s=at["time_offset"],
            datum_m=(at["datum_east"], at["datum_north"], at["datum_up"]),
            velocity_mps=(at["velocity_east"], at["velocity_north"], at["velocity_up"]),
            backscatter_slope=at["backscatter_slope"],
        )

    def read_m(self, range_m: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Return the ranges that are read for true ones."""
        return (1 + self.range_scale) * range_m + self.range_bias_m

    def true_m(self, range_m: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Return the true ranges of those that are read."""
        return (range_m - self.range_bias_m) / (1 + self.range_scale)


@dataclass(frozen=True, kw_only=True)
class BelievedMotion(Columns):
    """The reported motion of some pulses, and what an error of the instrument does to it.

    pose: of the antenna, as reported. time_s: of the pulses.
    R_mount_antenna: the antenna's axes in its mount (nose, right, down), as the encoders of the scan report them.
    turn_rad_s, acceleration_mps2: of the reported motion, world frame.
    line: number of the flight line of each pulse.
    """

    pose: Pose
    time_s: Float[np.ndarray, " pulse"]
    R_mount_antenna: Float[np.ndarray, "pulse 3 3"]
    turn_rad_s: Float[np.ndarray, "pulse 3"]
    acceleration_mps2: Float[np.ndarray, "pulse 3"]
    line: Int[np.ndarray, " pulse"]

    @property
    def within_lines(self) -> Bool[np.ndarray, " pulse"]:
        """Pulses that are not at the end of a line."""
        last = np.searchsorted(self.line, self.line, side="right") - 1
        first = np.searchsorted(self.line, self.line)
        time_s = self.time_s
        return np.minimum(time_s - time_s[first], time_s[last] - time_s) > ENDS_S

    def frames(self, size: int) -> tuple[Int[np.ndarray, "frame pulse"], float]:
        """Return successive pulses within a line, so many in each frame, and their interval, s, which is regular."""
        time_s, line, within = self.time_s, self.line, self.within_lines
        interval_s = float(np.median(np.diff(time_s)))
        first = np.arange(0, len(self) - size + 1, size)
        last = first + size - 1
        regular = np.abs(time_s[last] - time_s[first] - (size - 1) * interval_s) < interval_s / 100
        first = first[regular & (line[first] == line[last]) & within[first] & within[last]]
        return first[:, None] + np.arange(size), interval_s

    @property
    def R_world_mount(self) -> Float[np.ndarray, "pulse 3 3"]:
        """Axes of the mount, as reported: nose, right, down."""
        return self.pose.R_world_antenna @ self.R_mount_antenna.transpose(0, 2, 1)

    def without(self, errors: InstrumentErrors) -> "BelievedMotion":
        """Return the motion without errors of the instrument."""
        dt, pose = errors.time_offset_s, self.pose
        turned = Rotation.from_rotvec(self.turn_rad_s * dt).as_matrix()
        body = turned @ self.R_world_mount @ Rotation.from_rotvec(-np.array(errors.mounting_rad)).as_matrix()
        lever = body @ np.array(errors.lever_arm_m)
        squint = Rotation.from_rotvec([0.0, 0.0, -errors.squint_rad]).as_matrix()
        antenna = body @ self.R_mount_antenna @ squint
        gain = self.acceleration_mps2 * dt
        corrected = Pose(
            position_m=pose.position_m + pose.velocity_mps * dt + gain * (dt / 2) - lever - np.array(errors.datum_m),
            velocity_mps=pose.velocity_mps + gain - np.cross(self.turn_rad_s, lever) - np.array(errors.velocity_mps),
            R_world_antenna=antenna,
        )
        return replace(self, pose=corrected, R_mount_antenna=self.R_mount_antenna @ squint)

    def moved(self, change: Float[np.ndarray, "pulse 9"]) -> "BelievedMotion":
        """Return the motion with each antenna turned (rotation vector), shifted (m) and its velocity changed (m/s)."""
        pose = self.pose
        corrected = Pose(
            position_m=pose.position_m + change[:, 3:6],
            velocity_mps=pose.velocity_mps + change[:, 6:],
            R_world_antenna=Rotation.from_rotvec(change[:, :3]).as_matrix() @ pose.R_world_antenna,
        )
        return replace(self, pose=corrected)

    def per_error(self, names: Sequence[str]) -> Float[np.ndarray, "pulse 9 error"]:
        """Return the antenna's rotation vector, shift (m) and change of velocity (m/s) per unit of each error."""
        body, pose = self.R_world_mount, self.pose
        change = np.zeros((len(self), 9, len(names)))
        for column, name in enumerate(names):
            if name in ANGLES:
                change[:, :3, column] = -body[:, :, ANGLES.index(name)]
            elif name == "squint":
                change[:, :3, column] = -pose.R_world_antenna[:, :, 2]
            elif name.startswith("lever"):
                side = body[:, :, SIDES.index(name.removeprefix("lever_"))]
                change[:, 3:6, column] = -side
                change[:, 6:, column] = -np.cross(self.turn_rad_s, side)
            elif name.startswith("datum"):
                change[:, 3 + WAYS.index(name.removeprefix("datum_")), column] = -1.0
            elif name.startswith("velocity"):
                change[:, 6 + WAYS.index(name.removeprefix("velocity_")), column] = -1.0
            elif name == "time_offset":
                change[:, :3, column] = self.turn_rad_s
                change[:, 3:6, column] = pose.velocity_mps
                change[:, 6:, column] = self.acceleration_mps2
        return change


def believed_motion(pulses: Pulses, scan: Scan | None) -> BelievedMotion:
    """Return the reported motion of all pulses of a flight.

    pulses: with measured poses, in the order of their times.
    scan: of the antenna in its mount; None if unknown: the nose then points along the velocity over ground, and wings
        are level, to which axes mounting and lever arm refer.
    """
    pose, time_s = pulses.measured, pulses.time_s
    if scan is None:
        heading = np.arctan2(pose.velocity_mps[:, 0], pose.velocity_mps[:, 1])
        mount = world_from_level(np.column_stack([np.zeros((len(heading), 2)), heading]))
        antenna = mount.transpose(0, 2, 1) @ pose.R_world_antenna
    else:
        antenna = scan.point(time_s).R_mount_antenna
        mount = pose.R_world_antenna @ antenna.transpose(0, 2, 1)
    step = np.linalg.norm(np.diff(pose.velocity_mps, axis=0), axis=1)
    turns = step > INSTANTANEOUS * np.linalg.norm(pose.velocity_mps, axis=1)[:-1]
    line = np.cumsum(np.concatenate([[False], (np.diff(time_s) > LINE_GAP_S) | turns])).astype(np.int64)
    before, after = _around(time_s, line)
    step_s = np.maximum(time_s[after] - time_s[before], 1e-9)[:, None]
    turn = Rotation.from_matrix(mount[after] @ mount[before].transpose(0, 2, 1)).as_rotvec()
    gain = pose.velocity_mps[after] - pose.velocity_mps[before]
    return BelievedMotion(
        pose=pose,
        time_s=time_s,
        R_mount_antenna=antenna,
        turn_rad_s=turn / step_s,
        acceleration_mps2=gain / step_s,
        line=line,
    )


def _around(
    time_s: Float[np.ndarray, " pulse"], line: Int[np.ndarray, " pulse"]
) -> tuple[Int[np.ndarray, " pulse"], Int[np.ndarray, " pulse"]]:
    """Return the pulses half a step before and after each, on the same line."""
    first = np.searchsorted(line, line, side="left")
    last = np.searchsorted(line, line, side="right") - 1
    before = np.maximum(np.searchsorted(time_s, time_s - HALF_STEP_S), first)
    after = np.minimum(np.searchsorted(time_s, time_s + HALF_STEP_S, side="right") - 1, last)
    return np.minimum(before, after), np.maximum(before, after)


def stretches(line: Int[np.ndarray, " pulse"], fewest: int = MIN_STRETCH) -> Int[np.ndarray, " pulse"]:
    """Return the stretch of the flight that each pulse is in: parts of lines, alike in their numbers of pulses."""
    length = max(fewest, -(-len(line) // STRETCHES))
    within = np.arange(len(line)) - np.searchsorted(line, line)
    _, number = np.unique(line * len(line) + within // length, return_inverse=True)
    return number
