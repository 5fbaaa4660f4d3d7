"""A GPS/IMU with errors: the antenna pose that it reports, named grades, and errors as stated by a flight log.

The trajectory is the true motion of the inertial navigation system (INS). Its report has errors of position,
velocity and attitude, each the sum of three parts: constant, white (new at every pulse) and first-order
Gauss-Markov (an error that drifts and decays to zero; its autocorrelation is sigma^2 exp(-|t| / T)). The
report may have a late time stamp. The antenna pose follows from it through a lever arm and a boresight alignment
that have errors as well.

The named grades of GPS/IMU give the sources of their numbers. Every quantity is a standard deviation and is taken as a
first-order Gauss-Markov error, since a filter's output drifts and does not jump. Basis of each number:

- First-hand, the maker's claim, untested: position, velocity and heading of the "consumer" and "rtk" grades (Blicube's
  specifications of its GRTK, RMS).
- First-hand, the maker's test, but no truth: position of the "survey" grade. It is the RMS difference between two
  post-processed solutions (PP-RTX against SmartBase, 100 data sets), the better of which is believed accurate to
  1-2 cm horizontally and 2-4 cm in height; common systematic errors do not show, and a real-time solution does not
  reach this.
- Second-hand: roll and pitch of "rtk" (the maker's claim, as listed by a user). Roll and pitch of "survey"
  are from a trade journal's report on sensors aboard a ship; an aircraft moves differently.
- From notes, the source itself not at hand when this was written: attitude of "consumer" (datasheet), and the figures
  of the trade journal.
- Our assumptions: the type of process and its correlation times, those of `NavigationTable`, which no source gives;
  that a horizontal figure combines both axes, hence each is 1 / sqrt(2) of it, and that a velocity applies to
  every axis; that the heading error of two antennas is inverse to their distance; that "survey" measures velocity no
  better than GRTK. The part of an RTK position that grows with the distance to its base, 1 mm per km, is left out.

With `navigation = "from_log"` the log of a flight sets the size of the errors. The logged flight is taken as the true
one: its stated standard deviations scale a first-order Gauss-Markov process of unit variance, drawn from the seed.
Logs do not state correlation times; those of `NavigationTable` are assumed.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from pydantic import ValidationError
from scipy.spatial.transform import Rotation
from scipy.special import ndtri

from sionna_radar.flight.frames import Vector3, antenna_place, body_motion, world_from_body
from sionna_radar.flight.pulses import Pose
from sionna_radar.flight.trajectory import Trajectory
from sionna_radar.foundation.errors import InputFileError, Problem, RadarError, ScenarioError
from sionna_radar.foundation.input_file import parse_toml, read_text
from sionna_radar.foundation.randomness import Stream, pulse_generator, pulse_uniforms
from sionna_radar.scenario.platform import LoggedErrorsTable, NavigationTable
from sionna_radar.scenario.problems import translate

ZERO: Vector3 = (0.0, 0.0, 0.0)
# Uniform numbers in [0, 1) include zero, whose normal quantile is infinite.
MIN_UNIFORM = 2.0**-54


@dataclass(frozen=True, kw_only=True)
class ErrorParts:
    """Errors of a vector: a constant, and standard deviations of its white and its Gauss-Markov part."""

    constant: Vector3 = ZERO
    white: Vector3 = ZERO
    markov: Vector3 = ZERO
    correlation_s: float = 60.0


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
        normal = pulse_generator(self.seed, Stream.WANDER, self.channel).standard_normal((self.count, 3))
        decay = np.exp(-self.step_s / self.correlation_s)
        normal[1:] *= np.sqrt(1 - decay**2)  # the first is drawn from the stationary distribution
        # SciPy's signal package is slow to import.
        from scipy.signal import lfilter

        values: Float[np.ndarray, "time 3"] = lfilter([1.0], [1.0, -decay], normal, axis=0)
        return values

    def at(self, time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Return the processes at some times."""
        grid_position = np.clip((time_s - self.start_s) / self.step_s, 0, self.count - 1)
        lower = np.minimum(grid_position.astype(np.int64), max(self.count - 2, 0))
        weight = (grid_position - lower)[:, None]
        upper = np.minimum(lower + 1, self.count - 1)
        return (1 - weight) * self.values[lower] + weight * self.values[upper]


@dataclass(frozen=True, kw_only=True)
class InertialErrors:
    """The errors of an INS, in SI units and radians; a `Navigation`.

    position, velocity: world frame (east, north, up).
    attitude: roll, pitch, heading.
    time_offset_s: lag of the report behind the radar's clock.
    lever_arm_m: assumed lever arm from the INS to the antenna, nose-right-down.
    boresight_rad: rotation of the antenna's mount about nose, right and down, assumed minus true.
    seed: of all random parts.
    span_s, step_s: times of the flight and the step at which the Gauss-Markov parts are drawn.
    """

    position: ErrorParts = field(default_factory=ErrorParts)
    velocity: ErrorParts = field(default_factory=ErrorParts)
    attitude: ErrorParts = field(default_factory=ErrorParts)
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

    @cached_property
    def _wander(self) -> tuple[GaussMarkov, ...]:
        start, end = self.span_s
        return tuple(
            GaussMarkov(
                start_s=start,
                step_s=self.step_s,
                count=int(np.ceil((end - start) / self.step_s)) + 1,
                correlation_s=part.correlation_s,
                seed=self.seed,
                channel=channel,
            )
            for channel, part in enumerate((self.position, self.velocity, self.attitude))
        )


def inertial_errors(
    table: NavigationTable, trajectory: Trajectory, chirp_rate_hz: float, seed: int
) -> InertialErrors | None:
    """Return the navigation system of a scenario; None if it has no errors."""
    if not table.has_errors:
        return None
    start, end = trajectory.cruise_s()
    lever = np.array(table.lever_arm_m) + np.array(table.lever_arm_error_m)
    return InertialErrors(
        position=ErrorParts(
            constant=_vector(table.position_constant_m),
            white=_vector(table.position_white_m),
            markov=_vector(table.position_markov_m),
            correlation_s=table.position_correlation_s,
        ),
        velocity=ErrorParts(
            constant=_vector(table.velocity_constant_mps),
            white=_vector(table.velocity_white_mps),
            markov=_vector(table.velocity_markov_mps),
            correlation_s=table.velocity_correlation_s,
        ),
        attitude=ErrorParts(
            constant=_radians(table.attitude_constant_deg),
            white=_radians(table.attitude_white_deg),
            markov=_radians(table.attitude_markov_deg),
            correlation_s=table.attitude_correlation_s,
        ),
        time_offset_s=table.time_offset_s,
        lever_arm_m=_vector(lever),
        boresight_rad=_radians(table.boresight_error_deg),
        seed=seed,
        # Pulse times are the middles of chirps.
        span_s=(start + 0.5 / chirp_rate_hz, end),
        step_s=1 / chirp_rate_hz,
    )


def _vector(value: float | Vector3 | Float[np.ndarray, " 3"]) -> Vector3:
    x, y, z = (float(v) for v in np.broadcast_to(value, 3))
    return x, y, z


def _radians(value: float | Vector3) -> Vector3:
    return _vector(np.deg2rad(np.broadcast_to(value, 3)))


GRTK = "Blicube GRTK, the manufacturer's performance specifications (github.com/blikvm/ardupilot_rtk)"


@dataclass(frozen=True, kw_only=True)
class Grade:
    """A grade of GPS/IMU: its errors, and the source of the numbers."""

    errors: NavigationTable
    source: str


GRADES = {
    # 1.5 m horizontal and 2.5 m vertical RMS of a single-point fix, 0.03 m/s; attitude 0.4 deg, heading 1.0 deg.
    "consumer": Grade(
        errors=NavigationTable(
            position_markov_m=(1.06, 1.06, 2.5), velocity_markov_mps=0.03, attitude_markov_deg=(0.4, 0.4, 1.0)
        ),
        source=(
            f"position, velocity: {GRTK}, single point; attitude: Moog Crossbow NAV440 datasheet rev. B, from notes"
        ),
    ),
    # 1 cm + 1 ppm horizontal and 1.5 cm + 1 ppm vertical, heading 0.2 deg over 1 m; roll and pitch in motion 0.5 deg.
    "rtk": Grade(
        errors=NavigationTable(
            position_markov_m=(0.007, 0.007, 0.015), velocity_markov_mps=0.03, attitude_markov_deg=(0.5, 0.5, 0.2)
        ),
        source=(
            f"position, velocity, heading: {GRTK}, RTK, antennas 1 m apart; roll, pitch: Xsens MTi-30 in motion, "
            "second-hand, as listed by github.com/deepguider/dg_cart_ros"
        ),
    ),
    # North 0.021, east 0.020, down 0.056 m RMS over 100 data sets; roll and pitch 0.01 to 0.025 deg at moderate rates.
    "survey": Grade(
        errors=NavigationTable(
            position_markov_m=(0.020, 0.021, 0.056),
            velocity_markov_mps=0.03,
            attitude_markov_deg=(0.025, 0.025, 0.1),
        ),
        source=(
            "position: Applanix POSPac PP-RTX, airborne accuracy assessment, table 1 (differences between two "
            "post-processed solutions); roll, pitch: Hydro International, motion sensor performance (five sensors "
            f"side by side on a ship), from notes; velocity, heading: {GRTK}, heading scaled to antennas 2 m apart"
        ),
    ),
}


def load_grades(path: Path) -> dict[str, Grade]:
    """Read grades from a TOML file: one table each, with the keys of [platform.navigation] and a `source`.

    Raises
    ------
    InputFileError
        The file is missing or not TOML, or a table is wrong.

    """
    text = read_text(path, "grades", "give a TOML file of [name] tables of platform.navigation keys")
    try:
        tables = parse_toml(text)
        return {
            name: Grade(
                source=str(table.get("source", path)),
                errors=_errors(path, name, {key: v for key, v in table.items() if key != "source"}),
            )
            for name, table in tables.items()
        }
    except RadarError:
        raise
    except (ValueError, AttributeError) as error:
        message = f"{path}: not a table of navigation grades ({error}); give [name] tables of platform.navigation keys"
        raise InputFileError(message) from error


def _errors(path: Path, name: str, table: dict[str, Any]) -> NavigationTable:
    try:
        return NavigationTable.model_validate(table)
    except ValidationError as error:
        problems = [replace(p, field=f"{name}.{p.field}") for p in translate(error.errors(), NavigationTable)]
        message = str(ScenarioError(problems, f"{path}: not a table of navigation grades"))
        raise InputFileError(message) from error


UNIT = (1.0, 1.0, 1.0)


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


def logged_errors(table: LoggedErrorsTable, trajectory: Trajectory, chirp_rate_hz: float, seed: int) -> LoggedErrors:
    """Return the navigation system of a recorded flight.

    Raises ScenarioError for a flight without a log, or with one that states no errors.
    """
    if trajectory.logged_sigma is None:
        message = (
            "'from_log' needs platform.log with a covariance, innovations or sigma columns, and there are none; give "
            "kind = 'errors' with the errors themselves"
        )
        raise ScenarioError([Problem("platform.navigation.kind", message)])
    start, end = trajectory.cruise_s()
    position, velocity, attitude = table.correlation_s
    return LoggedErrors(
        position=ErrorParts(markov=UNIT, correlation_s=position),
        velocity=ErrorParts(markov=UNIT, correlation_s=velocity),
        attitude=ErrorParts(markov=UNIT, correlation_s=attitude),
        lever_arm_m=table.lever_arm_m,
        sigma=trajectory.logged_sigma,
        seed=seed,
        span_s=(start + 0.5 / chirp_rate_hz, end),
        step_s=1 / chirp_rate_hz,
    )
