"""Scattering by particles: Mie's sphere, spheroids, and the Rayleigh limit.

Spheres are miepython's, after Wiscombe 1979, "Mie scattering calculations" (NCAR/TN-140+STR).

Of a spheroid, the fields inside and outside are sums of vector spherical waves; their coefficients match the tangential
fields on the boundary in the least-squares sense, separately for each azimuthal order about the axis. It is the method
by which Morrison and Cross computed flattened raindrops (1974, "Scattering of a plane electromagnetic wave by
axisymmetric raindrops", Bell System Technical Journal 53, 955-1019). Time goes as exp(-i w t).
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float, Int
from scipy.constants import speed_of_light
from scipy.special import lpmv, spherical_jn, spherical_yn

from sionna_radar.foundation.numerics import gauss_legendre


def mie_backscatter(size: Float[np.ndarray, " n"], refractive_index: complex) -> Float[np.ndarray, " n"]:
    """Return the radar cross-sections of spheres over their geometric ones, pi a^2.

    size: circumference in wavelengths, above 0.
    """
    from miepython import efficiencies_mx

    return efficiencies_mx(np.conj(refractive_index), size)[2]  # it has time as exp(+i w t)


# Nodes from pole to pole per degree of the waves.
NODES_PER_DEGREE = 2
# Degrees beyond those of a sphere: needed by a non-spherical shape of any size.
MIN_DEGREES = 5.0


@dataclass(frozen=True, kw_only=True)
class SpheroidEcho:
    """Backscattering amplitudes, over the wavelength / (2 pi), for each look direction.

    vertical: for a field in the plane of the axis and the line of sight; horizontal: for one across it. The received
    component refers to the same axis as the transmitted one, so both are equal for a sphere; the cross-section is
    |amplitude|^2 lambda^2 / pi.
    """

    vertical: Complex[np.ndarray, " look"]
    horizontal: Complex[np.ndarray, " look"]


def spheroid_echo(
    size: float, axis_ratio: float, refractive_index: complex, look_rad: Float[np.ndarray, " look"]
) -> SpheroidEcho:
    """Return the backscatter of one spheroid.

    Tested against Mie spheres, small spheroids, and T-matrix results down to axis ratios of 0.8.

    size: circumference, in wavelengths, of the sphere of the same volume.
    axis_ratio: length along the axis of symmetry over the diameter across it: below one for a flattened drop.
    refractive_index: of the drop; its imaginary part is positive for absorption.
    look_rad: angles between the line of sight and the axis, above 0 and below pi.
    """
    degree = int(np.ceil(size + 4.0 * np.cbrt(size) + MIN_DEGREES))
    cosine, weight = gauss_legendre(NODES_PER_DEGREE * degree)
    boundary = _Boundary.of(size, axis_ratio, cosine, weight)
    turn = 2 * np.pi * np.arange(4 * degree) / (4 * degree)
    incident = _incident(boundary, turn, look_rad)
    # In a small drop the curl is weaker than the field by its size, and equally informative.
    rows = (np.array([1.0, 1.0, 1 / min(size, 1.0), 1 / min(size, 1.0)])[:, None] * boundary.weight).reshape(-1, 1)
    amplitude = np.zeros((2, len(look_rad)), dtype=complex)
    for order in range(degree):
        degrees = np.arange(max(order, 1), degree + 1)
        outside, inside = (_waves(boundary, order, degrees, index) for index in (None, refractive_index))
        matrix = np.concatenate([outside, -inside], axis=1) * rows
        sizes = np.linalg.norm(matrix, axis=0)
        harmonic = np.einsum("crp,p->cr", incident.reshape(-1, len(cosine) * 4, len(turn)), np.exp(-1j * order * turn))
        right_side = -(harmonic / len(turn)).T * rows
        solved = np.linalg.lstsq(matrix / sizes, right_side, rcond=None)[0] / sizes[:, None]
        wave = solved[: 2 * len(degrees)].reshape(2, len(degrees), 2, len(look_rad))
        # Orders of either sign contribute equally.
        amplitude += (1 if order == 0 else 2) * _far_field(wave, order, degrees, look_rad)
    return SpheroidEcho(vertical=amplitude[0], horizontal=amplitude[1])


@dataclass(frozen=True)
class _Boundary:
    """Nodes on the surface: cosine of the polar angle, distance from the centre times 2 pi / wavelength, its slope.

    slope: d(distance)/d(polar angle) over the distance. weight: square root of each node's share of the surface.
    """

    cosine: Float[np.ndarray, " node"]
    distance: Float[np.ndarray, " node"]
    slope: Float[np.ndarray, " node"]
    weight: Float[np.ndarray, " node"]

    @staticmethod
    def of(
        size: float, axis_ratio: float, cosine: Float[np.ndarray, " node"], weight: Float[np.ndarray, " node"]
    ) -> "_Boundary":
        """Return the surface of a spheroid at quadrature nodes of the polar angle."""
        across = size * axis_ratio ** (-1 / 3)
        flat = 1 / axis_ratio**2 - 1
        distance = across / np.sqrt(1 + flat * cosine**2)
        slope = flat * cosine * np.sqrt(1 - cosine**2) / (1 + flat * cosine**2)
        return _Boundary(cosine, distance, slope, np.sqrt(weight * distance**2 * np.sqrt(1 + slope**2)))


def _waves(
    boundary: _Boundary, order: int, degrees: Int[np.ndarray, " n"], refractive_index: complex | None
) -> Complex[np.ndarray, "row wave"]:
    """Return the tangential E and curl E of the waves M and N: outgoing ones outside, regular ones inside."""
    index = 1.0 if refractive_index is None else refractive_index
    z = (index * boundary.distance)[:, None]
    n = degrees[None, :]
    radial = spherical_jn(n, z)
    before = spherical_jn(n - 1, z)
    if refractive_index is None:
        radial, before = radial + 1j * spherical_yn(n, z), before + 1j * spherical_yn(n - 1, z)
    legendre, legendre_over_sine, slope = _legendre(order, degrees, boundary.cosine)
    # (z f)' / z of f = j or h.
    spread = before - n * radial / z
    tilt = boundary.slope[:, None]
    m_theta, m_phi = 1j * radial * legendre_over_sine, -radial * slope
    n_theta = spread * slope + tilt * n * (n + 1) * radial / z * legendre
    n_phi = 1j * spread * legendre_over_sine
    e = np.block([[m_theta, n_theta], [m_phi, n_phi]])
    curl = index * np.block([[n_theta, m_theta], [n_phi, m_phi]])
    return np.concatenate([e, curl])


def _legendre(
    order: int, degrees: Int[np.ndarray, " n"], cosine: Float[np.ndarray, " node"]
) -> tuple[Float[np.ndarray, "node n"], Float[np.ndarray, "node n"], Float[np.ndarray, "node n"]]:
    """Return P, order P / sin and dP / d(angle) of the associated Legendre functions."""
    n, x = degrees[None, :], cosine[:, None]
    sine = np.sqrt(1 - x**2)
    value = lpmv(order, n, x)
    slope = (n * x * value - (n + order) * lpmv(order, n - 1, x)) / sine
    return value, order * value / sine, slope


def _incident(
    boundary: _Boundary, turn: Float[np.ndarray, " turn"], look_rad: Float[np.ndarray, " look"]
) -> Complex[np.ndarray, "polarization look field node turn"]:
    """Return tangential E and curl E of plane waves, in the plane of the axis and across it, on the boundary."""
    x, sine = boundary.cosine[:, None], np.sqrt(1 - boundary.cosine[:, None] ** 2)
    c, s = np.cos(turn)[None], np.sin(turn)[None]
    radial = np.stack([sine * c, sine * s, x + 0 * c])
    theta = np.stack([x * c, x * s, -sine + 0 * c])
    phi = np.stack([-s + 0 * x, c + 0 * x, 0 * x * c])
    tangent = theta + boundary.slope[None, :, None] * radial
    field = np.empty((2, len(look_rad), 4, *radial.shape[1:]), dtype=complex)
    for look, angle in enumerate(look_rad):
        ahead = np.array([np.sin(angle), 0.0, np.cos(angle)])
        vertical, horizontal = np.array([np.cos(angle), 0.0, -np.sin(angle)]), np.array([0.0, 1.0, 0.0])
        wave = np.exp(1j * boundary.distance[:, None] * np.tensordot(ahead, radial, 1))
        for polarization, (e, h) in enumerate(((vertical, horizontal), (horizontal, -vertical))):
            for row, (vector, factor) in enumerate(((e, 1.0), (e, 1.0), (h, 1j), (h, 1j))):
                axis = (tangent, phi)[row % 2]
                field[polarization, look, row] = factor * wave * np.tensordot(vector, axis, 1)
    return field


def _far_field(
    wave: Complex[np.ndarray, "kind n polarization look"],
    order: int,
    degrees: Int[np.ndarray, " n"],
    look_rad: Float[np.ndarray, " look"],
) -> Complex[np.ndarray, "polarization look"]:
    """Return the co-polar backscattering amplitude along each line of sight."""
    _, legendre_over_sine, slope = _legendre(order, degrees, -np.cos(look_rad))
    phase = (-1j) ** degrees[None, :] * (-1.0) ** order  # backward direction: half a turn about the axis
    m, n = np.moveaxis(wave, (0, 1), (0, 3))  # polarization look n
    vertical = (phase * (-1j * m[0] * 1j * legendre_over_sine + n[0] * slope)).sum(axis=1)
    horizontal = -(phase * (-1j * m[1] * -slope + n[1] * 1j * legendre_over_sine)).sum(axis=1)
    return np.stack([vertical, horizontal])


DB_PER_KM_PER_NEPER_PER_M = 10.0 * math.log10(math.e) * 1000.0


def clausius_mossotti(permittivity: complex) -> complex:
    """Return (eps - 1)/(eps + 2), the polarizability of a sphere over three times its volume."""
    return (permittivity - 1.0) / (permittivity + 2.0)


@dataclass(frozen=True, kw_only=True)
class Aerosol:
    """Small spheres of one substance in air.

    volume_fraction: cubic metres of substance in a cubic metre of air.
    echo_radius_m: (mean r^6 / mean r^3)^(1/3), the radius of equal spheres with the same mass and echo.
    """

    permittivity: complex
    volume_fraction: float
    echo_radius_m: float

    def attenuation_db_per_km(self, frequency_hz: float) -> float:
        """Return the one-way specific attenuation: absorption by the spheres and, far less, scattering."""
        wave_number = 2.0 * math.pi * frequency_hz / speed_of_light
        factor = clausius_mossotti(self.permittivity)
        absorbed = 3.0 * wave_number * factor.imag
        scattered = 2.0 * wave_number**4 * abs(factor) ** 2 * self.echo_radius_m**3
        return DB_PER_KM_PER_NEPER_PER_M * self.volume_fraction * (absorbed + scattered)

    def reflectivity_per_m(self, frequency_hz: float) -> float:
        """Return the radar cross-section of a cubic metre (m2/m3).

        A sphere has 4 pi k^4 |K|^2 r^6, and there are volume_fraction / (4 pi r^3 / 3) of them.
        """
        wave_number = 2.0 * math.pi * frequency_hz / speed_of_light
        factor = abs(clausius_mossotti(self.permittivity)) ** 2
        return 3.0 * wave_number**4 * factor * self.volume_fraction * self.echo_radius_m**3
