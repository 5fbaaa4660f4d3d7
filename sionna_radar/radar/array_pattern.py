"""Pattern of a planar phased array: element pattern times array factor, steered by phases.

In direction cosines (u to the left, v up, of the array's face) the array factor is the Fourier sum of the weights over
the places, and a linear phase moves it without changing its shape: f(u, v) = AF(u - u0, v - v0) e(u, v), with e the
element's pattern. Elements farther apart than half a wavelength repeat the beam one wavelength over their spacing
away: grating lobes, which a beam steered far from broadside brings into view.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import finufft
import numpy as np
from jaxtyping import Complex, Float
from scipy.ndimage import map_coordinates

from sionna_radar.flight.frames import steering
from sionna_radar.radar.antenna import Antenna, Pattern, antenna_of

# Array-factor samples per beamwidth (1 / array size in wavelengths), and the largest number along an axis.
SAMPLES_PER_BEAM, MAX_SAMPLES = 16, 6000
# A difference of two direction cosines, and a margin for the last sample.
REACH = 2.02


@dataclass(frozen=True)
class ElementPattern:
    """The usual model of an element in front of a ground plane: power cos^exponent of the angle from its axis."""

    exponent: float

    def amplitude(self, direction: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Return the amplitude over the peak's toward unit vectors; none backward."""
        return np.maximum(direction[:, 0], 0.0) ** (self.exponent / 2)

    @property
    def directivity(self) -> float:
        """2 (exponent + 1), from the integral of cos^exponent over the half sphere."""
        return 2 * (self.exponent + 1)

    @property
    def step_rad(self) -> float:
        """Angle within which the pattern hardly changes."""
        return float(np.deg2rad(2.0))

    @property
    def R_face_antenna(self) -> Float[np.ndarray, "3 3"]:
        """Identity: boresight is the normal of the face."""
        return np.eye(3)


@dataclass(frozen=True)
class ArrayFactor:
    """The magnitude of an array factor over its peak, on equally spaced differences of direction cosines.

    samples: rows are differences upward, columns to the left, from -REACH to REACH.
    """

    samples: Float[np.ndarray, "row column"]

    def at(self, left: Float[np.ndarray, " k"], up: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        """Return the magnitude at differences of direction cosines, bilinear between the samples."""
        rows, columns = self.samples.shape
        row = (up + REACH) * ((rows - 1) / (2 * REACH))
        column = (left + REACH) * ((columns - 1) / (2 * REACH))
        return map_coordinates(self.samples, [row, column], output=np.float64, order=1)


def array_factor(
    place_wavelengths: Float[np.ndarray, "element 2"], weight: Complex[np.ndarray, " element"]
) -> ArrayFactor:
    """Return the magnitude of the array factor over its peak, of elements at places (left, up) in wavelengths."""
    centred = place_wavelengths - (place_wavelengths.min(axis=0) + place_wavelengths.max(axis=0)) / 2
    size = np.ptp(place_wavelengths, axis=0) + 0.5
    columns, rows = (int(min(MAX_SAMPLES, np.ceil(2 * REACH * SAMPLES_PER_BEAM * s))) | 1 for s in size)
    # Sums over elements of w exp(2 pi i (x u + y v)) on the grid: a non-uniform Fourier transform of type 1.
    step = [2 * REACH / (n - 1) for n in (columns, rows)]
    angle = [np.ascontiguousarray(2 * np.pi * centred[:, axis] * step[axis]) for axis in (0, 1)]
    summed = finufft.nufft2d1(*angle, weight.astype(np.complex128), (columns, rows), isign=1, eps=1e-9, nthreads=1)
    return ArrayFactor(np.abs(summed).T.astype(np.float32) / float(np.abs(weight).sum()))


@dataclass(frozen=True)
class ArrayPattern:
    """The pattern of a planar array about its beam: x of the antenna's frame is the axis of the steered beam.

    factor: the array factor; element: the pattern of an element, in the frame of the face.
    beam_wavelengths: size of the array, left and up.
    azimuth_rad, elevation_rad: of the beam from the normal of the face, toward the left and up.
    """

    factor: ArrayFactor
    element: Pattern
    beam_wavelengths: tuple[float, float]
    azimuth_rad: float = 0.0
    elevation_rad: float = 0.0

    @cached_property
    def R_face_antenna(self) -> Float[np.ndarray, "3 3"]:
        """Rotation from the frame of the beam to the frame of the face."""
        return steering(self.azimuth_rad, self.elevation_rad)

    def amplitude(self, direction: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Return the amplitude over that on the beam's axis toward unit vectors."""
        face = direction @ self.R_face_antenna.T
        beam = self.R_face_antenna[:, 0]
        factor = self.factor.at(face[:, 1] - beam[1], face[:, 2] - beam[2])
        return factor * self.element.amplitude(face) / self.element.amplitude(beam[None])[0]

    @cached_property
    def directivity(self) -> float:
        """4 pi over the integral of the relative power, summed in direction cosines of the face."""
        # Polar angles instead of u and v: dOmega = sin t dt dphi is not singular at the rim. Six nodes per beam.
        nodes = int(np.clip(6 * np.pi * max(self.beam_wavelengths), 200, 4000))
        tilt = (np.arange(nodes) + 0.5) * (np.pi / nodes)
        turn = (np.arange(2 * nodes) + 0.5) * (np.pi / nodes)
        total = 0.0
        for t in tilt:
            face = np.column_stack([np.full(len(turn), np.cos(t)), np.sin(t) * np.cos(turn), np.sin(t) * np.sin(turn)])
            power = self.amplitude(face @ self.R_face_antenna) ** 2
            total += float(power.sum()) * np.sin(t)
        return 4 * np.pi / (total * (np.pi / nodes) ** 2)

    @property
    def step_rad(self) -> float:
        """Angle within which the pattern hardly changes: an eighth of a beam."""
        return 1 / (8 * max(self.beam_wavelengths))


def steered(antenna: Antenna, azimuth_rad: float, elevation_rad: float = 0.0) -> Antenna:
    """Return an array with its beam steered from the normal of its face, in the frame of that beam.

    Parameters
    ----------
    antenna:
        An antenna with an `ArrayPattern`.
    azimuth_rad:
        Steering angle to the left, rad.
    elevation_rad:
        Steering angle up, rad.

    Returns
    -------
    The antenna with its beam steered.

    Raises
    ------
    TypeError
        The antenna is not an array.
    """
    if not isinstance(antenna.transmit, ArrayPattern):
        raise TypeError("only an array can be steered; give radar.antenna.kind = 'array'")
    transmit, receive = antenna.transmit, antenna.receive
    return antenna_of(
        replace(transmit, azimuth_rad=azimuth_rad, elevation_rad=elevation_rad),
        replace(receive, azimuth_rad=azimuth_rad, elevation_rad=elevation_rad)
        if isinstance(receive, ArrayPattern)
        else receive,
        polarization=antenna.polarization,
        receives=antenna.receives,
        axial_ratio_db=antenna.axial_ratio_db,
        efficiency=antenna.efficiency,
    )
