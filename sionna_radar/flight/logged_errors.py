"""Navigation errors as large as the log of a flight states: `navigation = "from_log"`.

The flight that was logged is taken as the true one: what a log says of its own errors gives their size, and a
first-order Gauss-Markov process of unit variance, drawn from the seed, gives what they were in this flight.
Logs do not state correlation times; those of `NavigationTable` are assumed.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.flight.navigation import ErrorParts, InertialErrors
from sionna_radar.flight.pulses import register_navigation
from sionna_radar.flight.trajectory import Trajectory
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.scenario.navigation import LoggedErrorsTable

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


@register_navigation("from_log", LoggedErrorsTable)
def logged_errors(table: LoggedErrorsTable, trajectory: Trajectory, chirp_rate_hz: float, seed: int) -> LoggedErrors:
    """Return the navigation system of a recorded flight.

    Raises ScenarioError for a flight without a log, or with one that says nothing of its errors.
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
