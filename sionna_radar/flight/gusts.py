"""Wind on a planned flight: crab angle, and Dryden gusts that disturb attitude and position.

Spectra of MIL-F-8785C (1980), 3.7.2, of the low-altitude model (below 1000 ft, where its lengths and intensities are
held): with h the height and L_w = h, L_u = L_v = h / (0.177 + 0.000823 h)^1.2 in feet, and
sigma_u = sigma_v = sigma_w / (0.177 + 0.000823 h)^0.4, against the angular frequency w at an airspeed V with T = L / V

    Phi_u(w) = sigma^2 (2 T / pi) / (1 + (T w)^2)
    Phi_v(w) = sigma^2 (T / pi) (1 + 3 (T w)^2) / (1 + (T w)^2)^2          (and w alike)

one-sided. u is along the mean wind, v across it, w up; Taylor's frozen turbulence moves past at the airspeed.

The response of the aircraft is a model of ours, linear and the same for all aircraft: the nose follows the angle of the
gust (gust over airspeed) into the relative wind, and a side gust rolls the aircraft away from it, with one time
constant (`attitude_response_s`); the aircraft drifts with a gust by the drag of DRAG_S, and a position loop of natural
period `position_response_s` times 2 pi and damping DAMPING brings it back. Gusts and response are one linear system
driven by white noise, discretised exactly (transition matrix and noise covariance by Van Loan 1978), with a stationary
initial state.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.constants import foot
from scipy.interpolate import CubicHermiteSpline, CubicSpline
from scipy.linalg import expm, solve_continuous_lyapunov

from sionna_radar.flight.trajectory import Trajectory
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.randomness import Stream, pulse_generator

DRAG_S, DAMPING = 5.0, 0.7
# The model's heights, m.
LOWEST_M, HIGHEST_M = 10 * foot, 1000 * foot
INTENSITY = 0.1  # of the vertical gusts, per mean wind
MIN_AIRSPEED_MPS = 1.0
STEP_S = 0.02
MAX_STEPS = 2_000_000
# Number of response states (attitude, displacement, its rate), after the gust's own states.
ANSWERS = 3


@dataclass(frozen=True, kw_only=True)
class Dryden:
    """The gusts along one axis: standard deviation, length over airspeed, and whether along the wind (u)."""

    sigma_mps: float
    time_s: float
    along: bool

    @property
    def state_space(self) -> tuple[Float[np.ndarray, "k k"], Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
        """Matrix, input of unit white noise, and output (the gust) of the shaping filter."""
        t = self.time_s
        if self.along:
            return np.array([[-1 / t]]), np.array([1.0]), np.array([self.sigma_mps * np.sqrt(2 / t)])
        matrix = np.array([[0.0, 1.0], [-1 / t**2, -2 / t]])
        return matrix, np.array([0.0, 1.0]), self.sigma_mps * np.sqrt(t) * np.array([1 / t**2, np.sqrt(3) / t])

    def density(self, omega_rad_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the one-sided power spectral density of the model, (m/s)^2 per rad/s."""
        x = (self.time_s * omega_rad_s) ** 2
        if self.along:
            return self.sigma_mps**2 * 2 * self.time_s / np.pi / (1 + x)
        return self.sigma_mps**2 * self.time_s / np.pi * (1 + 3 * x) / (1 + x) ** 2


def dryden_axes(height_m: float, airspeed_mps: float, vertical_mps: float) -> tuple[Dryden, Dryden, Dryden]:
    """Return the gusts along the wind, across it and up, at a height and airspeed; see the module."""
    height_ft = float(np.clip(height_m, LOWEST_M, HIGHEST_M)) / foot
    ratio = 0.177 + 0.000823 * height_ft
    across_s = height_ft / ratio**1.2 * foot / airspeed_mps
    across = Dryden(sigma_mps=vertical_mps / ratio**0.4, time_s=across_s, along=False)
    up = Dryden(sigma_mps=vertical_mps, time_s=height_ft * foot / airspeed_mps, along=False)
    return replace(across, along=True), across, up


@dataclass(frozen=True, kw_only=True)
class Gusts:
    """Gusts over a flight and the response of the aircraft, drawn once on a grid of times.

    axes: along the wind, across it (to the left of where it blows), up.
    """

    axes: tuple[Dryden, Dryden, Dryden]
    end_s: float
    attitude_s: float
    position_s: float
    seed: int
    step_s: float = STEP_S

    @cached_property
    def time_s(self) -> Float[np.ndarray, " step"]:
        """The times of the grid."""
        return np.arange(int(np.ceil(self.end_s / self.step_s)) + 2) * self.step_s

    @cached_property
    def states(self) -> tuple[Float[np.ndarray, "step 4"], ...]:
        """Per axis: gust, low-passed gust that the attitude follows (m/s), displacement (m) and its rate (m/s)."""
        return tuple(self._axis(axis) for axis in range(3))

    def _axis(self, axis: int) -> Float[np.ndarray, "step 4"]:
        matrix, drive, output = self.axes[axis].state_space
        if self.axes[axis].sigma_mps == 0:
            return np.zeros((len(self.time_s), 4))
        k = len(drive)
        A = np.zeros((k + ANSWERS, k + ANSWERS))
        A[:k, :k] = matrix
        A[k, :k], A[k, k] = output / self.attitude_s, -1 / self.attitude_s
        A[k + 1, k + 2] = 1.0
        A[k + 2, :k] = output / DRAG_S
        A[k + 2, k + 1 :] = -1 / self.position_s**2, -2 * DAMPING / self.position_s - 1 / DRAG_S
        noise = np.outer(np.append(drive, np.zeros(ANSWERS)), np.append(drive, np.zeros(ANSWERS)))
        transition, covariance = _over_a_step(A, noise, self.step_s)
        normal = pulse_generator(self.seed, Stream.GUSTS, axis).standard_normal((len(self.time_s), len(A)))
        noise_steps = normal @ _root(covariance).T
        state = _root(solve_continuous_lyapunov(A, -noise)) @ normal[0]
        states = np.empty_like(noise_steps)
        states[0] = state
        for step in range(1, len(states)):
            state = transition @ state + noise_steps[step]
            states[step] = state
        return np.column_stack([states[:, :k] @ output, states[:, k:]])


def _over_a_step(
    A: Float[np.ndarray, "k k"], noise: Float[np.ndarray, "k k"], step_s: float
) -> tuple[Float[np.ndarray, "k k"], Float[np.ndarray, "k k"]]:
    """Return the transition matrix of a step and the covariance of its process noise (Van Loan 1978)."""
    k = len(A)
    block = np.zeros((2 * k, 2 * k))
    block[:k, :k], block[:k, k:], block[k:, k:] = -A, noise, A.T
    exponential = expm(block * step_s)
    transition = exponential[k:, k:].T
    return transition, transition @ exponential[:k, k:]


def _root(covariance: Float[np.ndarray, "k k"]) -> Float[np.ndarray, "k k"]:
    """Return a square root of a covariance that may be singular."""
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2)
    return vectors * np.sqrt(np.maximum(values, 0.0))


@dataclass(frozen=True, kw_only=True)
class Wind:
    """A mean wind and the response of the aircraft to its gusts.

    from_rad: where it comes from, clockwise from grid north.
    gust_mps: standard deviation of the vertical gusts.
    crab: whether the nose points along the motion through the air.
    attitude_s, position_s: time constants of the responses; see the module.
    """

    speed_mps: float
    from_rad: float
    gust_mps: float
    crab: bool
    attitude_s: float
    position_s: float


def in_wind(trajectory: Trajectory, wind: Wind, height_m: float, speed_mps: float, seed: int) -> Trajectory:
    """Return a planned flight in wind.

    trajectory: the flight in still air.
    wind: the wind.
    height_m, speed_mps: of the flight, over the ground.
    seed: of the gusts.

    Raises ScenarioError if the flight is too long.
    """
    if trajectory.end_s / STEP_S > MAX_STEPS:
        message = (
            f"gusts are limited to flights of {MAX_STEPS * STEP_S:,.0f} s, and this one takes {trajectory.end_s:,.0f}"
        )
        raise ScenarioError.of("platform.wind", f"{message}; shorten it")
    toward = wind.from_rad + np.pi
    along = np.array([np.sin(toward), np.cos(toward)])
    left = np.array([-along[1], along[0]])
    airspeed = max(float(np.hypot(speed_mps, wind.speed_mps)), MIN_AIRSPEED_MPS)
    gusts = Gusts(
        axes=dryden_axes(height_m, airspeed, wind.gust_mps),
        end_s=trajectory.end_s,
        attitude_s=wind.attitude_s,
        position_s=wind.position_s,
        seed=seed,
    )
    flight = _Shaken(
        still=trajectory,
        gusts=gusts,
        R_world_wind=np.array([[*along, 0.0], [*left, 0.0], [0.0, 0.0, 1.0]]).T,
        wind_mps=along * wind.speed_mps if wind.crab else np.zeros(2),
        speed_mps=speed_mps,
        airspeed_mps=airspeed,
    )
    return replace(trajectory, position=flight.position, velocity=flight.velocity, euler=flight.euler)


@dataclass(frozen=True, kw_only=True)
class _Shaken:
    """A flight in wind: positions, velocities and attitudes of still air plus the response to gusts."""

    still: Trajectory
    gusts: Gusts
    R_world_wind: Float[np.ndarray, "3 3"]
    wind_mps: Float[np.ndarray, " 2"]
    speed_mps: float
    airspeed_mps: float

    @cached_property
    def _displacement(self) -> CubicHermiteSpline:
        displacement, rate = (np.column_stack([axis[:, k] for axis in self.gusts.states]) for k in (2, 3))
        R_wind_world = self.R_world_wind.T
        return CubicHermiteSpline(self.gusts.time_s, displacement @ R_wind_world, rate @ R_wind_world)

    @cached_property
    def _followed(self) -> CubicSpline:
        followed = np.column_stack([axis[:, 1] for axis in self.gusts.states])
        return CubicSpline(self.gusts.time_s, followed @ self.R_world_wind.T)

    def position(self, time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Return positions in the world frame."""
        return self.still.position(time_s) + self._displacement(np.clip(time_s, 0.0, self.gusts.time_s[-1]))

    def velocity(self, time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Return velocities in the world frame."""
        return self.still.velocity(time_s) + self._displacement(np.clip(time_s, 0.0, self.gusts.time_s[-1]), 1)

    def euler(self, time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Return roll, pitch and heading: crabbed, and shaken by the gusts."""
        roll, pitch, course = self.still.euler(time_s).T
        air = self.speed_mps * np.column_stack([np.sin(course), np.cos(course)]) - self.wind_mps
        heading = np.arctan2(air[:, 0], air[:, 1]) if self.wind_mps.any() else course
        east, north, up = self._followed(np.clip(time_s, 0.0, self.gusts.time_s[-1])).T / self.airspeed_mps
        right = east * np.cos(heading) - north * np.sin(heading)
        # Air moving right comes from the left: the nose turns left, and the left wing rises.
        return np.column_stack([roll + right, pitch - up, heading - right])
