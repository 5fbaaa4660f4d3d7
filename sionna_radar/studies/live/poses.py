"""Poses of a vehicle as they arrive, interpolated between: a trajectory that grows.

Between two poses the position is the cubic Hermite interpolant of positions and velocities, whose derivative is the
velocity; the attitude turns at a constant rate about a fixed axis. At the time of a pose its values return bit for bit.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from sionna_radar.flight.frames import R_WORLD_NED, Vector3, body_motion
from sionna_radar.flight.pulses import Pose, antenna_pose
from sionna_radar.flight.trajectory import Phase, Trajectory
from sionna_radar.foundation.columns import Columns
from sionna_radar.foundation.errors import PoseError

# What an array is made from: not NumPy's ArrayLike, in which numbers are complex ones.
Numbers = int | float | np.number | np.ndarray | Sequence[Any]

# Rays are cast in single precision; no time, place or speed of a flight is beyond this, in SI units.
LARGEST = 1e9


@dataclass(frozen=True, kw_only=True)
class Poses(Columns):
    """Poses of a vehicle at its navigation system, in the world frame (local east, north, up).

    time_s: since the start of the flight.
    euler_rad: roll, pitch and heading.
    turn_rad_s: turn rate about nose, right and down.
    """

    time_s: Float[np.ndarray, " pose"]
    position_m: Float[np.ndarray, "pose 3"]
    euler_rad: Float[np.ndarray, "pose 3"]
    velocity_mps: Float[np.ndarray, "pose 3"]
    turn_rad_s: Float[np.ndarray, "pose 3"]

    @classmethod
    def of(
        cls,
        time_s: Numbers,
        position_m: Numbers,
        attitude: Numbers,
        velocity_mps: Numbers | None = None,
        turn_rad_s: Numbers | None = None,
        *,
        before: "Poses | None" = None,
    ) -> "Poses":
        """Return one or several poses.

        Parameters
        ----------
        time_s:
            A time, or several, shape (pose,).
        position_m, velocity_mps:
            Shape (3,) or (pose, 3). Without velocities they are the mean ones since the pose before.
        attitude:
            Roll, pitch and heading, rad, shape (3,) or (pose, 3); or R_world_body, shape (3, 3) or (pose, 3, 3) with
            several times.
        turn_rad_s:
            Shape (3,) or (pose, 3). Without turn rates they are the mean ones since the pose before.
        before:
            The last pose before these.

        Raises
        ------
        PoseError
            Values that are not finite, of another shape, or a matrix that is no rotation.
        """
        time = _checked("time_s", np.atleast_1d(time_s), (-1,))
        count = (len(time), 3)
        position = _checked("position_m", position_m, count)
        matrices = np.shape(attitude) in ((3, 3) if len(time) == 1 else (), (*count, 3))
        euler = _euler(_checked("attitude", attitude, np.shape(attitude))) if matrices else attitude
        euler = _checked("attitude", euler, count)
        poses = cls(
            time_s=time, position_m=position, euler_rad=euler, velocity_mps=np.zeros(count), turn_rad_s=np.zeros(count)
        )
        earlier = poses if before is None else cls.concatenate([before, poses])
        step_s = _steps_s(earlier.time_s)
        if velocity_mps is None:
            velocity = _since_the_last(np.diff(earlier.position_m, axis=0) / step_s[:, None], count)
        else:
            velocity = _checked("velocity_mps", velocity_mps, count)
        if turn_rad_s is None:
            turn = _since_the_last(_turns(earlier.euler_rad) / step_s[:, None], count)
        else:
            turn = _checked("turn_rad_s", turn_rad_s, count)
        return replace(poses, velocity_mps=velocity, turn_rad_s=turn)


def _checked(name: str, like: Numbers, shape: tuple[int, ...]) -> Float[np.ndarray, "..."]:
    """Return finite values of a shape, of which -1 is any length; one pose may come without the first axis."""
    try:
        values = np.asarray(like, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise PoseError(f"{name}: is not made of real numbers ({error}); give {shape}") from error
    if len(shape) == 2 and shape[0] == 1 and values.ndim == 1:
        values = values[None]
    if values.ndim != len(shape) or any(want not in (-1, have) for want, have in zip(shape, values.shape, strict=True)):
        raise PoseError(f"{name}: has shape {values.shape}; give {shape}, one row for each time")
    if values.size == 0:
        raise PoseError(f"{name}: is empty; give at least one pose")
    if not np.isfinite(values).all():
        raise PoseError(f"{name}: must be finite, not {values[~np.isfinite(values)][0]}; leave out poses without a fix")
    if np.abs(values).max() > LARGEST:
        raise PoseError(
            f"{name}: must lie within {LARGEST:g}, not {values.flat[np.abs(values).argmax()]:g}; use SI units"
        )
    return values


def _euler(R_world_body: Float[np.ndarray, "... 3 3"]) -> Float[np.ndarray, "pose 3"]:
    matrices = R_world_body.reshape(-1, 3, 3)
    proper = np.allclose(matrices @ matrices.transpose(0, 2, 1), np.eye(3), atol=1e-6)
    if not proper or np.any(np.linalg.det(matrices) < 0):
        raise PoseError("attitude: R_world_body is no rotation; its columns are nose, right and down in world axes")
    return Rotation.from_matrix(R_WORLD_NED.T @ matrices).as_euler("ZYX")[:, ::-1]


def _rotation(euler_rad: Float[np.ndarray, "n 3"]) -> Rotation:
    """Return the rotations from body axes to north, east and down."""
    return Rotation.from_euler("ZYX", euler_rad[:, ::-1])


def _turns(euler_rad: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "step 3"]:
    """Return the turn from each attitude to the next, rad about the body's axes."""
    turned = _rotation(euler_rad)
    return (turned[:-1].inv() * turned[1:]).as_rotvec()


def _steps_s(time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, " step"]:
    """Return the steps of times; raises PoseError for one that is not after that before it."""
    step_s = np.diff(time_s)
    for row in np.flatnonzero(step_s <= 0):
        message = f"{time_s[row + 1]:.6g} s is not after {time_s[row]:.6g} s; poses come in the order of time"
        raise PoseError(f"time_s: {message}")
    return step_s


def _since_the_last(rate: Float[np.ndarray, "step 3"], shape: tuple[int, int]) -> Float[np.ndarray, "pose 3"]:
    """Return the rate of each pose: that since the one before; of a first one that to the next, or none."""
    if len(rate) == 0:
        return np.zeros(shape)
    return rate if len(rate) == shape[0] else np.concatenate([rate[:1], rate])


class PoseTrack:
    """The last poses of a vehicle, and the trajectory through them.

    kept_s: for how long poses are kept; times before the first of them extrapolate it.
    planned: the trajectory before the first pose arrives.
    """

    def __init__(self, kept_s: float, planned: Trajectory) -> None:
        self._kept_s, self._planned = kept_s, planned
        self._poses: Poses | None = None
        self._asked: Poses | None = None
        self._turn: Float[np.ndarray, "step 3"] = np.zeros((0, 3))
        self.trajectory = Trajectory(
            position=lambda time_s: self._at(time_s).position_m,
            velocity=lambda time_s: self._at(time_s).velocity_mps,
            euler=lambda time_s: self._at(time_s).euler_rad,
            turn=lambda time_s: self._at(time_s).turn_rad_s,
            phases=((Phase.CRUISE, -np.inf, np.inf),),
        )

    @property
    def last(self) -> Poses | None:
        """The last pose; None before the first."""
        return None if self._poses is None else self._poses.rows(slice(-1, None))

    def append(self, poses: Poses) -> None:
        """Add poses after those that are there, and forget the oldest; PoseError if they are not after them."""
        if (old := self._poses) is not None:
            # The last pose before the times that are kept still bounds them.
            first = np.searchsorted(old.time_s, poses.time_s[0] - self._kept_s, side="right") - 1
            poses = Poses.concatenate([old.rows(slice(max(first, 0), None)), poses])
            _steps_s(poses.time_s)
        self._poses, self._asked, self._turn = poses, None, _turns(poses.euler_rad)

    def restart(self, poses: Poses) -> None:
        """Forget all poses but these."""
        self._poses = None
        self.append(poses)

    def _at(self, time_s: Float[np.ndarray, " n"]) -> Poses:
        """Return the poses at some times; beyond the first and the last at constant velocity."""
        if self._poses is None:
            planned = body_motion(self._planned, time_s)
            return Poses(
                time_s=time_s,
                position_m=planned.position_m,
                euler_rad=planned.euler_rad,
                velocity_mps=planned.velocity_mps,
                turn_rad_s=planned.turn_rad_s,
            )
        # Position, velocity and attitude are asked for one after another.
        if self._asked is None or not np.array_equal(self._asked.time_s, time_s):
            self._asked = self._between(self._poses, time_s)
        return self._asked

    def _between(self, knots: Poses, time_s: Float[np.ndarray, " n"]) -> Poses:
        inside = np.clip(time_s, knots.time_s[0], knots.time_s[-1])
        beyond = (time_s - inside)[:, None]
        if len(knots) == 1:
            return replace(
                knots.rows(np.zeros(len(time_s), dtype=np.int64)),
                time_s=time_s,
                position_m=knots.position_m + beyond * knots.velocity_mps,
            )
        low = np.clip(np.searchsorted(knots.time_s, inside, side="right") - 1, 0, len(knots) - 2)
        one, other = knots.rows(low), knots.rows(low + 1)
        step = (other.time_s - one.time_s)[:, None]
        s = (inside - one.time_s)[:, None] / step
        rise = s**2 * (3 - 2 * s)
        position = (
            (1 - rise) * one.position_m
            + rise * other.position_m
            + step * (s * (1 - s) ** 2 * one.velocity_mps - s**2 * (1 - s) * other.velocity_mps)
        )
        velocity = (
            6 * s * (1 - s) * (other.position_m - one.position_m) / step
            + (1 - s) * (1 - 3 * s) * one.velocity_mps
            + s * (3 * s - 2) * other.velocity_mps
        )
        turned = _rotation(one.euler_rad) * Rotation.from_rotvec(s * self._turn[low])
        euler = turned.as_euler("ZYX")[:, ::-1]
        at_one, at_other = s[:, 0] == 0, s[:, 0] == 1
        euler[at_one], euler[at_other] = one.euler_rad[at_one], other.euler_rad[at_other]
        return Poses(
            time_s=time_s,
            position_m=position + beyond * velocity,
            euler_rad=euler,
            velocity_mps=velocity,
            turn_rad_s=(1 - s) * one.turn_rad_s + s * other.turn_rad_s,
        )


@dataclass(frozen=True)
class ReportedPoses:
    """A navigation system that reports the poses it is given; a `Navigation`."""

    track: PoseTrack
    lever_arm_m: Vector3

    def measure(
        self,
        index: Int[np.ndarray, " pulse"],
        time_s: Float[np.ndarray, " pulse"],
        trajectory: Trajectory,
        R_body_antenna: Float[np.ndarray, "pulse 3 3"],
    ) -> Pose:
        """Return the reported poses of the antenna; see `Navigation`."""
        del index, trajectory  # the true motion is not what was reported
        return antenna_pose(self.track.trajectory, time_s, R_body_antenna, self.lever_arm_m)
