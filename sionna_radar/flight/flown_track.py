"""Table of the true and measured motion of a flight over time, for files and figures."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from sionna_radar.flight.frames import R_WORLD_NED, antenna_place, body_motion, world_from_body
from sionna_radar.flight.pulses import Pulses, PulseSchedule
from sionna_radar.foundation.columns import Columns

STEP_S = 0.05
MAX_ROWS = 100_000
NO_PULSE = -1
BEFORE_S = 1e-3


@dataclass(frozen=True, kw_only=True)
class FlownTrack(Columns):
    """A flight, one row per time; NaN for unknown values.

    time_s: since the start of the flight.
    pulse: index of the pulse at that time, -1 between pulses: the navigation is sampled at pulses only.
    position_m, velocity_mps, euler_rad: true motion at the navigation system, world frame; roll, pitch, heading.
    antenna_m: true position of the antenna, at the end of its lever arm.
    measured_antenna_m, measured_velocity_mps: of the antenna, as the navigation system reports them.
    measured_euler_rad: attitude of the platform as used in processing (includes the antenna's misalignment).
    """

    time_s: Float[np.ndarray, " row"]
    pulse: Int[np.ndarray, " row"]
    position_m: Float[np.ndarray, "row 3"]
    velocity_mps: Float[np.ndarray, "row 3"]
    euler_rad: Float[np.ndarray, "row 3"]
    antenna_m: Float[np.ndarray, "row 3"]
    measured_antenna_m: Float[np.ndarray, "row 3"]
    measured_velocity_mps: Float[np.ndarray, "row 3"]
    measured_euler_rad: Float[np.ndarray, "row 3"]


def flown_track(schedule: PulseSchedule, step_s: float = STEP_S) -> FlownTrack:
    """Sample a whole flight, take-off and landing included, about every `step_s`, at pulse times where possible.

    The step is increased to keep at most 100,000 rows.
    """
    trajectory = schedule.trajectory
    time_s, pulse = _rows(schedule, max(step_s, trajectory.end_s / MAX_ROWS))
    motion = body_motion(trajectory, time_s)
    nan_rows = np.full((len(time_s), 3), np.nan)
    position, velocity, euler = nan_rows.copy(), nan_rows.copy(), nan_rows.copy()
    at_pulse = np.flatnonzero(pulse != NO_PULSE)
    if len(at_pulse):
        pulses = schedule.pulses(pulse[at_pulse])
        position[at_pulse], velocity[at_pulse] = pulses.measured.position_m, pulses.measured.velocity_mps
        euler[at_pulse] = _measured_attitude(pulses, motion.euler_rad[at_pulse])
    return FlownTrack(
        time_s=time_s,
        pulse=pulse,
        position_m=motion.position_m,
        velocity_mps=motion.velocity_mps,
        euler_rad=motion.euler_rad,
        antenna_m=antenna_place(motion, schedule.lever_arm_m)[0],
        measured_antenna_m=position,
        measured_velocity_mps=velocity,
        measured_euler_rad=euler,
    )


def _rows(schedule: PulseSchedule, step_s: float) -> tuple[Float[np.ndarray, " row"], Int[np.ndarray, " row"]]:
    """Return equally spaced times, each moved to a pulse within half a step, and the ends of the phases."""
    trajectory = schedule.trajectory
    edges = np.unique([0.0, *(edge for _, start, end in trajectory.phases for edge in (start, end))])
    # A planned flight changes velocity instantaneously: one row before and one after each phase boundary.
    edges = np.unique(np.concatenate([edges, edges[1:] - BEFORE_S]))
    regular = np.arange(1, int(trajectory.end_s / step_s) + 1) * step_s
    pulse = np.full(len(regular), NO_PULSE)
    if len(schedule):
        nearest = _nearest(schedule.time_s, regular)
        close = np.abs(schedule.time_s[nearest] - regular) <= step_s / 2
        regular = np.where(close, schedule.time_s[nearest], regular)
        pulse = np.where(close, nearest, NO_PULSE)
    # Splines through much closer rows would ring.
    separate = np.abs(edges[_nearest(edges, regular)] - regular) > step_s / 4
    separate &= np.append(True, np.diff(regular) > 0) & (regular < trajectory.end_s)
    time_s = np.concatenate([edges, regular[separate]])
    pulses = np.concatenate([np.full(len(edges), NO_PULSE), pulse[separate]])
    order = np.argsort(time_s)
    return time_s[order], pulses[order]


def _nearest(sorted_s: Float[np.ndarray, " n"], time_s: Float[np.ndarray, " m"]) -> Int[np.ndarray, " m"]:
    after = np.clip(np.searchsorted(sorted_s, time_s), 1, max(len(sorted_s) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(sorted_s) - 1)
    closer = np.abs(sorted_s[after] - time_s) < np.abs(sorted_s[before] - time_s)
    return np.where(closer, after, before)


def _measured_attitude(pulses: Pulses, euler_rad: Float[np.ndarray, "pulse 3"]) -> Float[np.ndarray, "pulse 3"]:
    """Return the roll, pitch and heading that give the measured antenna pointing; encoders measure the mount."""
    R_antenna_body = pulses.true.R_world_antenna.transpose(0, 2, 1) @ world_from_body(euler_rad)
    R_ned_body = R_WORLD_NED.T @ pulses.measured.R_world_antenna @ R_antenna_body
    return Rotation.from_matrix(R_ned_body).as_euler("ZYX", suppress_warnings=True)[:, ::-1]
