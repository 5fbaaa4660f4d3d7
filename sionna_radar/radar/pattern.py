"""Measured or computed radiation patterns over the whole sphere of directions.

In the antenna's frame (x boresight, y left, z up) a direction has an azimuth, positive toward the left, and an
elevation. Amplitudes are relative to the pattern's own peak; the directivity is 4 pi over the integral of their square,
whatever level a file states.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.integrate import trapezoid
from scipy.ndimage import map_coordinates

# Samples of a whole sphere, 0.05 deg apart; finer ones would take gigabytes.
MAX_SAMPLES = 30_000_000


@dataclass(frozen=True)
class ProductPattern:
    """The product of an azimuth and an elevation cut, F(az, el) = A(az) E(el): exact on each.

    Two measured cuts do not determine the pattern between them; their product is the pattern of a rectangular aperture
    with separable illumination, and the usual rule of antenna planning tools ("summing" in decibels).

    azimuth: amplitudes at equally spaced azimuths from -pi to pi.
    elevation: amplitudes at equally spaced elevations from -pi/2 to pi/2.
    """

    azimuth: Float[np.ndarray, " n"]
    elevation: Float[np.ndarray, " m"]

    def amplitude(self, direction: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Return amplitudes relative to the peak, at unit vectors."""
        azimuth, elevation = angles_of(direction)
        across = np.interp(azimuth, np.linspace(-np.pi, np.pi, len(self.azimuth)), self.azimuth)
        return across * np.interp(elevation, np.linspace(-np.pi / 2, np.pi / 2, len(self.elevation)), self.elevation)

    @cached_property
    def directivity(self) -> float:
        """4 pi over the integral of the relative power."""
        elevation = np.linspace(-np.pi / 2, np.pi / 2, len(self.elevation))
        across = trapezoid(self.azimuth**2, dx=2 * np.pi / (len(self.azimuth) - 1))
        return float(4 * np.pi / (across * trapezoid(self.elevation**2 * np.cos(elevation), elevation)))

    @property
    def step_rad(self) -> float:
        """Smaller of the two sample spacings."""
        return float(min(2 * np.pi / (len(self.azimuth) - 1), np.pi / (len(self.elevation) - 1)))

    @property
    def R_face_antenna(self) -> Float[np.ndarray, "3 3"]:
        """Identity: boresight is the normal of the face."""
        return np.eye(3)


@dataclass(frozen=True)
class SphericalPattern:
    """Amplitudes on an azimuth-elevation grid, interpolated bilinearly.

    samples: amplitudes at equally spaced elevations from -pi/2 to pi/2 (rows) and azimuths from -pi to pi.
    """

    samples: Float[np.ndarray, "elevation azimuth"]

    @staticmethod
    def of(
        amplitude: Callable[[Float[np.ndarray, "k 3"]], Float[np.ndarray, " k"]], step_rad: float
    ) -> "SphericalPattern":
        """Return a pattern sampled from a function of unit vectors in the antenna's frame.

        Parameters
        ----------
        amplitude:
            The relative amplitude toward unit vectors; its largest is taken as the peak.
        step_rad:
            Largest angle between neighbours.
        """
        rows = check_samples(step_rad)
        elevation, azimuth = np.linspace(-np.pi / 2, np.pi / 2, rows), np.linspace(-np.pi, np.pi, 2 * rows - 1)
        samples = np.empty((rows, 2 * rows - 1), dtype=np.float32)
        for row, angle in enumerate(elevation):
            samples[row] = amplitude(directions_of(azimuth, np.full(len(azimuth), angle)))
        return SphericalPattern(samples / samples.max())

    def amplitude(self, direction: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Return amplitudes relative to the peak, at unit vectors."""
        azimuth, elevation = angles_of(direction)
        rows, columns = self.samples.shape
        row = (elevation + np.pi / 2) * ((rows - 1) / np.pi)
        column = (azimuth + np.pi) * ((columns - 1) / (2 * np.pi))
        return map_coordinates(self.samples, [row, column], output=np.float64, order=1, mode="nearest")

    @cached_property
    def directivity(self) -> float:
        """4 pi over the integral of the relative power."""
        rows, columns = self.samples.shape
        elevation = np.linspace(-np.pi / 2, np.pi / 2, rows)
        azimuth_integral = np.array(
            [trapezoid(np.square(row, dtype=np.float64), dx=2 * np.pi / (columns - 1)) for row in self.samples]
        )
        return float(4 * np.pi / trapezoid(azimuth_integral * np.cos(elevation), elevation))

    @property
    def step_rad(self) -> float:
        """Angle between neighbouring rows."""
        return float(np.pi / (len(self.samples) - 1))

    @property
    def R_face_antenna(self) -> Float[np.ndarray, "3 3"]:
        """Identity: boresight is the normal of the face."""
        return np.eye(3)


def check_samples(step_rad: float) -> int:
    """Return the number of elevation rows of a sphere sampled every `step_rad`; ValueError above `MAX_SAMPLES`."""
    rows = int(np.ceil(np.pi / step_rad)) + 1
    if rows * (2 * rows - 1) > MAX_SAMPLES:
        raise ValueError(
            f"samples every {np.rad2deg(step_rad):.3g} deg over the sphere are more than {MAX_SAMPLES:,}; "
            "thin the pattern out to 0.05 deg"
        )
    return rows


def angles_of(direction: Float[np.ndarray, "k 3"]) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Return azimuth and elevation of unit vectors in the antenna's frame."""
    x, y, z = direction.T
    return np.arctan2(y, x), np.arcsin(np.clip(z, -1.0, 1.0))


def directions_of(azimuth: Float[np.ndarray, " k"], elevation: Float[np.ndarray, " k"]) -> Float[np.ndarray, "k 3"]:
    """Return unit vectors in the antenna's frame of azimuths and elevations."""
    level = np.cos(elevation)
    return np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
