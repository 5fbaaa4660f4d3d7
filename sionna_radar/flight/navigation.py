"""GPS/IMU error models: the antenna pose reported with errors, stated by a scenario or by a flight log.

The trajectory is the true motion of the inertial navigation system (INS). Its report has errors of position,
velocity and attitude, each the sum of three parts: constant, white (new at every pulse) and first-order
Gauss-Markov (an error that drifts and decays to zero; its autocorrelation is sigma^2 exp(-|t| / T)). The
report may have a late time stamp. The antenna pose follows from it through a lever arm and a boresight alignment
that have errors as well.

With `navigation = "from_log"` the log of a flight sets the size of the errors. The logged flight is taken as the true
one: its stated standard deviations scale a first-order Gauss-Markov process of unit variance, drawn from the seed.
Logs do not state correlation times; those of `NavigationTable` are assumed.
"""

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation
from scipy.special import ndtri

from sionna_radar.flight.frames import Vector3, antenna_place, body_motion, world_from_body
from sionna_radar.flight.pulses import Pose
from sionna_radar.flight.trajectory import Trajectory
from sionna_radar.foundation.columns import Columns
from sionna_radar.foundation.randomness import Stream, pulse_generator, pulse_uniforms

ZERO: Vector3 = (0.0, 0.0, 0.0)
# Uniform numbers in [0, 1) include zero, whose normal quantile is infinite.
MIN_UNIFORM = 2.0**-54
# Times of the grid of a process that are drawn at once where the flight has no known end.
DRAWN_AT_ONCE = 4096


@dataclass(frozen=True, kw_only=True)
class ErrorComponents:
    """Errors of a vector: a constant, and standard deviations of its white and its Gauss-Markov part."""

    constant: Vector3 = ZERO
    white: Vector3 = ZERO
    markov: Vector3 = ZERO
    correlation_s: float = 60.0


@dataclass(frozen=True, kw_only=True)
class StatedError:
    """What is stated of an error of navigation before the flight.

    name: in `instrument.UNKNOWNS`.
    sigma: returns its standard deviations, SI, at times.
    correlation_s: of a first-order Gauss-Markov process; infinite for a constant, zero for white noise.
    """

    name: str
    sigma: Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, " n"]]
    correlation_s: float


# Names of the errors of position, velocity and attitude, by axis, as `instrument.UNKNOWNS` has them.
NAMES = (
    ("datum_east", "datum_north", "datum_up"),
    ("velocity_east", "velocity_north", "velocity_up"),
    ("roll", "pitch", "heading"),
)
LEVER = ("lever_nose", "lever_right", "lever_down")


@dataclass(frozen=True, kw_only=True)
class GaussMarkov:
    """Unit first-order Gauss-Markov processes over a survey, drawn once on a fixed grid of times.

    The process is exact on the grid and interpolated in between.
    """

    start_s: float
    step_s: float
    count: int
    correlation_s: float
    seed: int
    channel: int

    @cached_property
    def values(self) -> Float[np.ndarray, "time 3"]:
        """The processes at the times of the grid."""
        return next(self.drawn(self.count))

    def drawn(self, length: int) -> Iterator[Float[np.ndarray, "time 3"]]:
        """Yield the processes at the times of the grid, in pieces of a length, without an end."""
        # SciPy's signal package is slow to import.
        from scipy.signal import lfilter

        generator = pulse_generator(self.seed, Stream.WANDER, self.channel)
        decay, state, first = np.exp(-self.step_s / self.correlation_s), np.zeros((1, 3)), 1
        while True:
            normal = generator.standard_normal((length, 3))
            normal[first:] *= np.sqrt(1 - decay**2)  # the first of all is drawn from the stationary distribution
            values, state = lfilter([1.0], [1.0, -decay], normal, axis=0, zi=state)
            first = 0
            yield values

    def at(self, time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Return the processes at some times."""
        grid_position = np.clip((time_s - self.start_s) / self.step_s, 0, self.count - 1)
        lower = np.minimum(grid_position.astype(np.int64), max(self.count - 2, 0))
        weight = (grid_position - lower)[:, None]
        upper = np.minimum(lower + 1, self.count - 1)
        return (1 - weight) * self._values_at(lower) + weight * self._values_at(upper)

    def _values_at(self, row: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        return self.values[row]


class EndlessGaussMarkov(GaussMarkov):
    """The same processes for a flight without a known end: read forward in time, what lies behind is dropped."""

    def _values_at(self, row: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        held, drawn = self._held
        if len(row) == 0:
            return np.zeros((0, 3))
        piece = row // DRAWN_AT_ONCE
        for number in range(max(held, default=-1) + 1, int(piece.max()) + 1):
            held[number] = next(drawn)
        for number in [number for number in held if number < piece.min() - 1]:
            del held[number]
        first = min(held)
        return np.concatenate(list(held.values()))[row - first * DRAWN_AT_ONCE]

    @cached_property
    def _held(self) -> tuple[dict[int, Float[np.ndarray, "time 3"]], Iterator[Float[np.ndarray, "time 3"]]]:
        return {}, self.drawn(DRAWN_AT_ONCE)


@dataclass(frozen=True, kw_only=True)
class InertialErrors:
    """The errors of an INS, in SI units and radians; a `Navigation`.

    position, velocity: world frame (east, north, up).
    attitude: roll, pitch, heading.
    time_offset_s: lag of the report behind the radar's clock.
    lever_arm_m: assumed lever arm from the INS to the antenna, nose-right-down.
    boresight_rad: rotation of the antenna's mount about nose, right and down, assumed minus true.
    seed: of all random parts.
    span_s, step_s: times of the flight, whose end may be infinite, and the step at which the Gauss-Markov parts are
        drawn.
    """

    position: ErrorComponents = field(default_factory=ErrorComponents)
    velocity: ErrorComponents = field(default_factory=ErrorComponents)
    attitude: ErrorComponents = field(default_factory=ErrorComponents)
    time_offset_s: float = 0.0
    lever_arm_m: Vector3 = ZERO
    boresight_rad: Vector3 = ZERO
    seed: int
    span_s: tuple[float, float]
    step_s: float

    def measure(
        self,
        index: Int[np.ndarray, " pulse"],
        time_s: Float[np.ndarray, " pulse"],
        trajectory: Trajectory,
        R_body_antenna: Float[np.ndarray, "pulse 3 3"],
    ) -> Pose:
        """Return the pose of the antenna as reported by the INS; see `Navigation`."""
        true_motion = body_motion(trajectory, time_s - self.time_offset_s)
        position_error, velocity_error, attitude_error = self.errors(index, time_s)
        motion = replace(
            true_motion,
            position_m=true_motion.position_m + position_error,
            velocity_mps=true_motion.velocity_mps + velocity_error,
            euler_rad=true_motion.euler_rad + attitude_error,
        )
        position, velocity_mps = antenna_place(motion, self.lever_arm_m)
        R_misaligned = Rotation.from_rotvec(self.boresight_rad).as_matrix()
        R_world_antenna = world_from_body(motion.euler_rad) @ R_misaligned @ R_body_antenna
        return Pose(position_m=position, velocity_mps=velocity_mps, R_world_antenna=R_world_antenna)

    def errors(
        self, index: Int[np.ndarray, " pulse"], time_s: Float[np.ndarray, " pulse"]
    ) -> tuple[Float[np.ndarray, "pulse 3"], Float[np.ndarray, "pulse 3"], Float[np.ndarray, "pulse 3"]]:
        """Return the errors of position (m), velocity (m/s) and attitude (rad)."""
        parts = (self.position, self.velocity, self.attitude)
        normal = np.zeros((len(index), 3, len(parts)))
        if any(any(p.white) for p in parts):
            uniform = pulse_uniforms(self.seed, Stream.NAVIGATION, index, 9)
            normal = ndtri(np.maximum(uniform, MIN_UNIFORM)).reshape(-1, 3, 3)
        sums = []
        for channel, p in enumerate(parts):
            error = np.array(p.constant) + np.array(p.white) * normal[:, channel]
            if any(p.markov):
                error = error + np.array(p.markov) * self._wander[channel].at(time_s)
            sums.append(error)
        return sums[0], sums[1], sums[2]

    def sizes(self, time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3 3"]:
        """Return the root mean square errors of position (m), velocity (m/s) and attitude (rad), by axis."""
        parts = (self.position, self.velocity, self.attitude)
        size = np.sqrt(np.sum(np.square([[p.constant, p.white, p.markov] for p in parts]), axis=1))
        return np.broadcast_to(size, (len(time_s), 3, 3))

    def stated(self, lever_arm_m: Vector3) -> tuple[StatedError, ...]:
        """Return the stated standard deviation of each error; a constant error's size counts as one.

        lever_arm_m: the true one.
        """
        found = []

        def state(name: str, size: float, correlation_s: float, axis: tuple[int, int] | None = None) -> None:
            if size != 0:
                found.append(StatedError(name=name, sigma=self._sized(abs(size), axis), correlation_s=correlation_s))

        for channel, part in enumerate((self.position, self.velocity, self.attitude)):
            for axis, name in enumerate(NAMES[channel]):
                mounted = self.boresight_rad[axis] if channel == 2 else 0.0
                state(name, float(np.hypot(part.constant[axis], mounted)), np.inf)
                state(name, part.markov[axis], part.correlation_s, (channel, axis))
                state(name, part.white[axis], 0.0, (channel, axis))
        for name, believed, true in zip(LEVER, self.lever_arm_m, lever_arm_m, strict=True):
            state(name, believed - true, np.inf)
        state("time_offset", self.time_offset_s, np.inf)
        return tuple(found)

    def _sized(
        self, size: float, axis: tuple[int, int] | None
    ) -> Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, " n"]]:
        """Return a function of time that gives a standard deviation of an axis of a channel, or of a constant."""
        del axis
        return lambda time_s: np.full(len(time_s), size)

    @cached_property
    def _wander(self) -> tuple[GaussMarkov, ...]:
        start, end = self.span_s
        kind = EndlessGaussMarkov if np.isinf(end) else GaussMarkov
        return tuple(
            kind(
                start_s=start,
                step_s=self.step_s,
                count=sys.maxsize if np.isinf(end) else int(np.ceil((end - start) / self.step_s)) + 1,
                correlation_s=part.correlation_s,
                seed=self.seed,
                channel=channel,
            )
            for channel, part in enumerate((self.position, self.velocity, self.attitude))
        )


@dataclass(frozen=True, kw_only=True)
class LoggedErrors(InertialErrors):
    """Errors of an INS whose standard deviations change with time; a `Navigation`.

    sigma: standard deviations of position, velocity and attitude by axis; NaN counts as none.
    """

    sigma: Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, "n 3 3"]]

    def errors(
        self, index: Int[np.ndarray, " pulse"], time_s: Float[np.ndarray, " pulse"]
    ) -> tuple[Float[np.ndarray, "pulse 3"], Float[np.ndarray, "pulse 3"], Float[np.ndarray, "pulse 3"]]:
        """Return the errors of position (m), velocity (m/s) and attitude (rad)."""
        sizes = np.nan_to_num(self.sigma(time_s))
        unit = super().errors(index, time_s)
        return sizes[:, 0] * unit[0], sizes[:, 1] * unit[1], sizes[:, 2] * unit[2]

    def sizes(self, time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3 3"]:
        """Return the root mean square errors of position (m), velocity (m/s) and attitude (rad), by axis."""
        return np.nan_to_num(self.sigma(time_s)) * super().sizes(time_s)

    def _sized(
        self, size: float, axis: tuple[int, int] | None
    ) -> Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, " n"]]:
        """Return a function of time: what the log states of an axis."""
        return super()._sized(size, axis) if axis is None else lambda t: size * np.nan_to_num(self.sigma(t))[:, *axis]


@dataclass(frozen=True, kw_only=True)
class KnownPoses(Columns):
    """Poses of all pulses of a survey that were estimated from its echoes; a `Navigation`.

    pose: of the pulses, in their order. time_s: of the pulses.
    sigma: standard deviations of position (m), velocity (m/s) and attitude (rad), by axis.
    """

    pose: Pose
    time_s: Float[np.ndarray, " pulse"]
    sigma: Float[np.ndarray, "pulse 3 3"]

    def measure(
        self,
        index: Int[np.ndarray, " pulse"],
        time_s: Float[np.ndarray, " pulse"],
        trajectory: Trajectory,
        R_body_antenna: Float[np.ndarray, "pulse 3 3"],
    ) -> Pose:
        """Return the estimated poses; see `Navigation`."""
        del time_s, trajectory, R_body_antenna
        return self.pose.rows(index)

    def sizes(self, time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3 3"]:
        """Return the standard deviations of position (m), velocity (m/s) and attitude (rad), by axis."""
        nearest = np.clip(np.searchsorted(self.time_s, time_s), 0, len(self.time_s) - 1)
        return self.sigma[nearest]
