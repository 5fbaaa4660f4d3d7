"""Adapter of antennas as an antenna pattern of Sionna RT."""

from typing import Any

import numpy as np
from jaxtyping import Float, Inexact
from scipy.spatial.transform import Rotation

from sionna_radar.radar.antenna import Antenna, Pattern
from sionna_radar.radar.array_pattern import REACH, ArrayPattern, ElementPattern
from sionna_radar.radar.pattern import ProductPattern, SphericalPattern
from sionna_radar.raytracer.backend import load_mitsuba, load_sionna

mi = load_mitsuba()
load_sionna()

import drjit as dr  # noqa: E402  (libLLVM and the variant must be chosen before these load)
import sionna.rt as rt  # noqa: E402


class SionnaPattern(rt.AntennaPattern):
    """An antenna of ours as a Sionna antenna pattern; |c|^2 is the power gain.

    tables: samples of the pattern, of a separable antenna its two cuts, and its peak voltage.
    jones: shares of the received field along Sionna's two axes, theta (ours for V, pointing down) and phi; None for
    what the antenna transmits.
    """

    def __init__(self, antenna: Antenna, jones: Inexact[np.ndarray, "2"] | None = None) -> None:
        # Reversing one axis swaps the two senses of circular polarization.
        components = (np.conj(antenna.jones[0]) if jones is None else jones).astype(complex).tolist()
        whole = antenna.transmit if jones is None or antenna.receive is None else antenna.receive
        self.tables: list[Any]
        voltage_toward, self.tables = _product_of_cuts(antenna) if whole is None else _whole(whole, antenna.efficiency)

        def pattern(theta, phi):  # type: ignore[no-untyped-def]
            sin_theta, cos_theta = dr.sincos(theta)
            sin_phi, cos_phi = dr.sincos(phi)
            voltage = voltage_toward(sin_theta * cos_phi, sin_theta * sin_phi, cos_theta)
            return tuple(mi.Complex2f(voltage * component.real, voltage * component.imag) for component in components)

        self.patterns = [pattern]


def _product_of_cuts(antenna: Antenna):  # type: ignore[no-untyped-def]
    """Return the voltage of a separable antenna against the direction cosines ahead, left and up, and its tables."""
    azimuth, elevation = (mi.Float(c.voltage.astype(np.float32)) for c in (antenna.azimuth, antenna.elevation))
    peak = dr.opaque(mi.Float, float(np.sqrt(antenna.peak_gain)))

    def voltage(ahead, left, up):  # type: ignore[no-untyped-def]
        product = _lookup(azimuth, (dr.clip(left, -1.0, 1.0) + 1.0) / 2) * _lookup(
            elevation, (dr.clip(up, -1.0, 1.0) + 1.0) / 2
        )
        return product * (peak * dr.sqrt(dr.maximum(ahead, 0.0)))

    return voltage, [azimuth, elevation, peak]


def _whole(pattern: Pattern, efficiency: float):  # type: ignore[no-untyped-def]
    """Return the voltage of a pattern against the direction cosines ahead, left and up, and its tables."""
    amplitude, tables = _amplitude(pattern)
    peak = dr.opaque(mi.Float, float(np.sqrt(efficiency * pattern.directivity)))
    return lambda ahead, left, up: peak * amplitude(ahead, left, up), [*tables, peak]


def _amplitude(pattern: Pattern):  # type: ignore[no-untyped-def]
    """Return a pattern's relative amplitude as a function on the device, interpolated as in NumPy, and its tables."""
    match pattern:
        case ProductPattern():
            azimuth, elevation = (mi.Float(cut.astype(np.float32)) for cut in (pattern.azimuth, pattern.elevation))
            return (
                lambda ahead, left, up: (
                    _lookup(azimuth, _azimuth_fraction(ahead, left)) * _lookup(elevation, _elevation_fraction(up))
                ),
                [azimuth, elevation],
            )
        case SphericalPattern():
            table = _Table(pattern.samples)
            return lambda ahead, left, up: table.at(_elevation_fraction(up), _azimuth_fraction(ahead, left)), [
                table.samples
            ]
        case ElementPattern():
            half = pattern.exponent / 2
            return lambda ahead, left, up: dr.power(dr.maximum(ahead, 0.0), half), []
        case ArrayPattern():
            return _steered(pattern)
    # Any other pattern, of someone's own, is sampled as finely as it says it changes.
    return _amplitude(SphericalPattern.of(pattern.amplitude, pattern.step_rad))


def _steered(pattern: ArrayPattern):  # type: ignore[no-untyped-def]
    table, (element, of_element) = _Table(pattern.factor.samples), _amplitude(pattern.element)
    beam = pattern.R_face_antenna[:, 0]
    level = 1 / float(pattern.element.amplitude(beam[None])[0])
    # Opaque, so that all beams of an array share one compiled kernel.
    turn = [[dr.opaque(mi.Float, float(value)) for value in row] for row in pattern.R_face_antenna]
    level, off_left, off_up = (dr.opaque(mi.Float, float(value)) for value in (level, beam[1], beam[2]))

    def amplitude(ahead, left, up):  # type: ignore[no-untyped-def]
        normal, across, along = (row[0] * ahead + row[1] * left + row[2] * up for row in turn)
        factor = table.at((along - off_up + REACH) / (2 * REACH), (across - off_left + REACH) / (2 * REACH))
        return factor * element(normal, across, along) * level

    return amplitude, [table.samples, *of_element]


def _azimuth_fraction(ahead, left):  # type: ignore[no-untyped-def]
    return dr.atan2(left, ahead) / (2 * dr.pi) + 0.5


def _elevation_fraction(up):  # type: ignore[no-untyped-def]
    return dr.safe_asin(up) / dr.pi + 0.5


class _Table:
    """A table on the device, read bilinearly at shares of its height and width."""

    def __init__(self, samples: Float[np.ndarray, "row column"]) -> None:
        # Opaque, so that tables of any size share one compiled kernel.
        (self._last_row, self._highest), (self._last_column, self._farthest) = (
            [dr.opaque(mi.Float, float(size - steps)) for steps in (1, 2)] for size in samples.shape
        )
        self._columns = dr.opaque(mi.UInt32, samples.shape[1])
        self.samples = mi.Float(np.ascontiguousarray(samples, dtype=np.float32).ravel())

    def at(self, height, width):  # type: ignore[no-untyped-def]
        """Return the table at shares of its height and width, from 0 to 1."""
        row, column = height * self._last_row, width * self._last_column
        below = mi.UInt32(dr.clip(row, 0, self._highest))
        near = mi.UInt32(dr.clip(column, 0, self._farthest))
        first = below * self._columns + near
        a, b = row - mi.Float(below), column - mi.Float(near)
        low = dr.lerp(dr.gather(mi.Float, self.samples, first), dr.gather(mi.Float, self.samples, first + 1), b)
        first += self._columns
        high = dr.lerp(dr.gather(mi.Float, self.samples, first), dr.gather(mi.Float, self.samples, first + 1), b)
        return dr.lerp(low, high, a)


def _lookup(table, place):  # type: ignore[no-untyped-def]
    """Return a table at a fraction of its length, linear between samples."""
    # Opaque, so that tables of any length share one compiled kernel.
    last, last_but_one = (dr.opaque(mi.Float, float(dr.width(table) - steps)) for steps in (1, 2))
    position = place * last
    below = mi.UInt32(dr.minimum(position, last_but_one))
    fraction = position - mi.Float(below)
    return dr.lerp(dr.gather(mi.Float, table, below), dr.gather(mi.Float, table, below + 1), fraction)


def sionna_angles(R_world_antenna: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 3"]:
    """Return the rotations about z, y and x by which Sionna describes an orientation."""
    # A beam straight down is in gimbal lock: any split of the rotation is right, so the warning is irrelevant.
    return Rotation.from_matrix(R_world_antenna).as_euler("ZYX", suppress_warnings=True)
