"""How a vehicle moves from turn to turn: at constant twist, but for white accelerations.

Over the time T a white acceleration of the density q adds errors of velocity and place with the covariance
q [[T^3 / 3, T^2 / 2], [T^2 / 2, T]] (Barfoot 2017, State Estimation for Robotics, section 3.4); here q = a^2 T for an
acceleration a that is typical over a turn.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from sionna_radar.studies.slam.registration import Prior, difference, predicted
from sionna_radar.studies.slam.surfaces import rotation


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Typical changes of the twist: m/s^2 ahead and to the right, rad/s^2 of the yaw rate."""

    acceleration_mps2: float = 2.0
    yaw_acceleration_rad_s2: float = float(np.deg2rad(20.0))

    def covariance(self, heading_rad: float, time_s: float) -> Float[np.ndarray, "6 6"]:
        """Return the covariance of the state after a time at constant twist."""
        change = np.diag(
            np.array([self.acceleration_mps2, self.acceleration_mps2, self.yaw_acceleration_rad_s2]) ** 2 * time_s**2
        )
        R = np.eye(3)
        R[:2, :2] = rotation(heading_rad)
        place, both = R @ change @ R.T * time_s**2 / 3, R @ change * time_s / 2
        return np.block([[place, both], [both.T, change]])

    def ahead(self, state: Float[np.ndarray, " 6"], time_s: float) -> Prior:
        """Return the state after a time."""
        mean = predicted(state, time_s)
        return Prior(mean=mean, information=np.linalg.inv(self.covariance(mean[2], time_s)))

    def factor(
        self, before: Float[np.ndarray, " 6"], after: Float[np.ndarray, " 6"], time_s: float
    ) -> tuple[Float[np.ndarray, "12 12"], Float[np.ndarray, " 12"]]:
        """Return information and gradient with respect to two successive states, to first order."""
        e = difference(after, predicted(before, time_s))
        J = np.zeros((6, 12))
        J[:, 6:] = np.eye(6)
        steps = np.array([1e-4, 1e-4, 1e-6, 1e-4, 1e-4, 1e-6])
        for i, h in enumerate(steps):
            shift = np.zeros(6)
            shift[i] = h
            J[:, i] = -difference(predicted(before + shift, time_s), predicted(before - shift, time_s)) / (2 * h)
        W = np.linalg.inv(self.covariance(after[2], time_s))
        return J.T @ W @ J, J.T @ W @ e


def travelled_m(state: Float[np.ndarray, "turn 6"]) -> Float[np.ndarray, " turn"]:
    """Return the way from the first state to each."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(state[:, :2], axis=0), axis=1))])
