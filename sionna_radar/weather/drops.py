"""Raindrops: size distribution, oblateness and depolarization, and fall speeds weighted by echo.

The shape of falling drops affects the polarization of the rain echo. Drag flattens larger drops more, and turbulence
tilts their axes about the vertical. With v the axis across the line of sight in the vertical plane and h the horizontal
one, a drop whose axis lies at the angle a from v in that view has the scattering matrix

    T | 1 0 |  +  D | cos 2a   sin 2a |
      | 0 1 |       | sin 2a  -cos 2a |        T = (S_v + S_h) / 2,  D = (S_v - S_h) / 2 in the drop's own axes.

A sphere has D = 0: it returns a circular wave only with the opposite sense, and V and H without cross-polar echo.
D vanishes as the square of the sine between the line of sight and the axis: seen from above a drop is round.

S_v and S_h come from spheroids at the carrier (`scattering`), not from Rayleigh's limit: at 77 GHz drops of 2 mm have
a backscatter minimum, and are two to three times as depolarizing (in amplitude) as small ones of their shape would be.
Neglected: the oscillation of drops larger than a millimetre, multiple scattering, and the effect of propagation through
the rain: at 25 mm/h H is attenuated by up to 0.42 dB/km more than V (P.838-3), which over 100 m and back reverses the
sense of -46 dB of a circular echo. At 77 GHz drops of a millimetre, nearly round, return most of the echo, and -40 dB
of it are of the same sense at 4 mm/h and 45 deg. The 15 to 25 dB of millimetre-wave radars in practice are due
to the axial ratio of their antennas (1 dB gives 18.8 dB).

Fall speeds of scatterers are given by the distribution of the reflectivity over fall speed.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Complex, Float, Inexact
from scipy.constants import speed_of_light

from sionna_radar.foundation.numerics import gauss_legendre
from sionna_radar.weather.permittivity import water_permittivity
from sionna_radar.weather.scattering import spheroid_echo
from sionna_radar.weather.validity import Precipitation, ValidityError


@dataclass(frozen=True, kw_only=True)
class ExponentialDrops:
    """Drops whose number per volume and diameter is N(D) = N0 exp(-L D).

    intercept_per_m4: N0, drops per cubic metre of air and metre of diameter.
    slope_per_m: L.
    """

    intercept_per_m4: float
    slope_per_m: float

    def density_per_m4(self, diameter_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the number of drops per cubic metre of air and metre of diameter."""
        return self.intercept_per_m4 * np.exp(-self.slope_per_m * diameter_m)


# Atlas, Srivastava and Sekhon 1973, Rev. Geophys. 11, 1-35: v = 9.65 - 10.3 exp(-600 D) m/s, D in metres, fitted
# to drops of 0.6 to 5.8 mm at sea level. The paper itself was not at hand; five public restatements agree, one
# naming its equation 24 and one the range of the fit.
FALL_LIMIT_MPS = 9.65
FALL_DEFICIT_MPS = 10.3
FALL_SLOPE_PER_M = 600.0


def fall_speed_mps(diameter_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return the terminal speed of raindrops at sea level; 0 for drops too small for the fit."""
    return np.maximum(FALL_LIMIT_MPS - FALL_DEFICIT_MPS * np.exp(-FALL_SLOPE_PER_M * diameter_m), 0.0)


# Marshall and Palmer 1948, J. Meteorol. 5, 165-166: N0 = 0.08 cm^-4, L = 41 R^-0.21 cm^-1, R in mm/h. The
# paper itself was not at hand: N0 was read in MetrTools dsd.py, both numbers in the code of the course notes
# "week9:marshall" on Stull's chapter 8, and the exponent at www.sjsu.edu/faculty/watkins/raindrop.htm.
MARSHALL_PALMER_INTERCEPT_PER_M4 = 8e6
MARSHALL_PALMER_SLOPE_PER_M = 4100.0
MARSHALL_PALMER_EXPONENT = -0.21


def marshall_palmer(rain_rate_mm_per_h: float) -> ExponentialDrops:
    """Return the Marshall-Palmer drops of a positive rain rate; ValidityError for any other.

    An average over many rain events; at 10 mm/h its water flux is 16 % larger than the rate.
    At millimetre wavelengths Laws and Parsons' mean drops give notably different results (de Wolf 2001,
    2000RS002369).

    Parameters
    ----------
    rain_rate_mm_per_h:
        Rain rate, mm/h.

    Returns
    -------
    The exponential drop-size distribution.

    Raises
    ------
    ValidityError
        The rain rate is not positive.
    """
    if not rain_rate_mm_per_h > 0:
        raise ValidityError(f"rain_rate_mm_per_h = {rain_rate_mm_per_h:g} must be positive")
    return ExponentialDrops(
        intercept_per_m4=MARSHALL_PALMER_INTERCEPT_PER_M4,
        slope_per_m=MARSHALL_PALMER_SLOPE_PER_M * rain_rate_mm_per_h**MARSHALL_PALMER_EXPONENT,
    )


# Brandes, Zhang and Vivekanandan 2002, J. Appl. Meteorol. 41, 674-685: height over width, D in mm, to 8 mm; read in
# pyTMatrix's and rustmatrix's collections of axis ratios, and within 0.02 of Beard and Chuang's polynomial of 1987.
AXIS_RATIO = np.polynomial.Polynomial([0.9951, 0.02510, -0.03644, 0.005303, -0.0002492])
# Huang, Bringi and Thurai 2008, J. Atmos. Oceanic Technol. 25, 1717-1723: canting angles of drops after an 80 m fall
# about zero, with a standard deviation of 7 to 8 deg.
CANTING_RAD = float(np.deg2rad(7.0))
# Linear depolarization of snow at 95 GHz: typical values after Pazmany, McIntosh, Kelly and Vali 1994 (IEEE TGRS 32,
# 731-739), some -17 dB for crystals of all orientations and -12 to -14 dB where they melt. The paper was not at hand.
SNOW_DEPOLARIZATION_DB = {Precipitation.DRY_SNOW: -18.0, Precipitation.WET_SNOW: -13.0}
# Smaller drops return a negligible echo, larger ones break up.
SMALLEST_M, LARGEST_M = 0.2e-3, 7e-3
NODES = 32
LOOKS_RAD = np.deg2rad([20.0, 45.0, 70.0, 90.0])
ANGLES_RAD = np.deg2rad(np.linspace(0.0, 90.0, 46))
TILT_NODES = 9


def axis_ratio(diameter_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return height over width of drops of an equivalent diameter; small ones are spheres."""
    return np.minimum(AXIS_RATIO(1e3 * diameter_m), 1.0)


@dataclass(frozen=True, kw_only=True)
class DropPolarization:
    """Moments of D over the mean power of T at increasing angles between the line of sight and the vertical.

    mean: of D T* cos 2a; upright, slanted: of |D|^2 cos^2 2a and of |D|^2 sin^2 2a.
    """

    angle_rad: Float[np.ndarray, " angle"]
    mean: Complex[np.ndarray, " angle"]
    upright: Float[np.ndarray, " angle"]
    slanted: Float[np.ndarray, " angle"]

    def power(
        self,
        angle_rad: Float[np.ndarray, " n"],
        transmitted: Inexact[np.ndarray, "n 2"],
        received: Inexact[np.ndarray, "n 2"],
    ) -> Float[np.ndarray, " n"]:
        """Return the power received, relative to that of spheres with a linear co-polar antenna.

        angle_rad: between the line of sight and the vertical, up or down.
        transmitted, received: unit fields, along v and h, of the antenna's ports, both as if transmitting.
        """
        angle = np.minimum(angle_rad, np.pi - angle_rad)
        mean, upright, slanted = (
            np.interp(angle, self.angle_rad, moment) for moment in (self.mean, self.upright, self.slanted)
        )
        (v, h), (rv, rh) = transmitted.T, received.T
        copolar, opposed, exchanged = rv * v + rh * h, rv * v - rh * h, rv * h + rh * v
        return (
            np.abs(copolar) ** 2
            + 2 * (np.conj(copolar) * opposed * mean).real
            + np.abs(opposed) ** 2 * upright
            + np.abs(exchanged) ** 2 * slanted
        )


def spheres() -> DropPolarization:
    """Return the polarization of droplets, dust and smoke, all taken as spheres."""
    zeros = np.zeros(len(ANGLES_RAD))
    return DropPolarization(angle_rad=ANGLES_RAD, mean=zeros.astype(complex), upright=zeros, slanted=zeros)


def snow_polarization(kind: Precipitation) -> DropPolarization:
    """Return the polarization of tumbling snowflakes: isotropic, with D from the linear depolarization."""
    level = np.full(len(ANGLES_RAD), 10 ** (SNOW_DEPOLARIZATION_DB[kind] / 10))
    zeros = np.zeros(len(ANGLES_RAD), dtype=complex)
    return DropPolarization(angle_rad=ANGLES_RAD, mean=zeros, upright=level, slanted=level)


@lru_cache(maxsize=8)
def drop_polarization(frequency_hz: float, drops: ExponentialDrops, temperature_k: float) -> DropPolarization:
    """Return the polarization of the rain echo, with drops canted by `CANTING_RAD` in each of two vertical planes."""
    diameter, weights = _diameters()
    density = weights * drops.density_per_m4(diameter)
    common, split = _amplitudes(frequency_hz, temperature_k)
    total = density @ np.abs(common) ** 2
    # Divided by the factors with which they vanish, so that the quotient is smooth in the angle.
    mean = density @ (split * np.conj(common)) / total / np.sin(LOOKS_RAD) ** 2
    power = density @ np.abs(split) ** 2 / total / np.sin(LOOKS_RAD) ** 4
    moments = np.array([_canted(angle, mean, power) for angle in ANGLES_RAD.tolist()])
    return DropPolarization(
        angle_rad=ANGLES_RAD, mean=moments[:, 0], upright=moments[:, 1].real, slanted=moments[:, 2].real
    )


def _diameters() -> tuple[Float[np.ndarray, " node"], Float[np.ndarray, " node"]]:
    """Return the nodes of integrals over the diameter and their weights, as shares of the span."""
    nodes, weights = gauss_legendre(NODES)
    return SMALLEST_M + (LARGEST_M - SMALLEST_M) * (1 + nodes) / 2, weights / 2


@lru_cache(maxsize=8)
def _amplitudes(frequency_hz: float, temperature_k: float) -> Complex[np.ndarray, "2 node look"]:
    """Return T and D of drops of each diameter."""
    index = water_permittivity(frequency_hz, temperature_k) ** 0.5
    diameter = _diameters()[0]
    amplitudes = np.empty((2, NODES, len(LOOKS_RAD)), dtype=complex)
    for node, (d, ratio) in enumerate(zip(diameter.tolist(), axis_ratio(diameter).tolist(), strict=True)):
        echo = spheroid_echo(np.pi * d * frequency_hz / speed_of_light, ratio, index, LOOKS_RAD)
        amplitudes[:, node] = (echo.vertical + echo.horizontal) / 2, (echo.vertical - echo.horizontal) / 2
    return amplitudes


def _canted(
    angle_rad: float, mean: Complex[np.ndarray, " look"], power: Float[np.ndarray, " look"]
) -> Complex[np.ndarray, " 3"]:
    """Return the three moments of `DropPolarization` at one angle, averaged over the drops' tilt."""
    node, weight = np.polynomial.hermite_e.hermegauss(TILT_NODES)
    x, y = np.meshgrid(CANTING_RAD * node, CANTING_RAD * node)
    weights = np.outer(weight, weight) / weight.sum() ** 2
    axis = np.stack([np.tan(x), np.tan(y), np.ones_like(x)]) / np.sqrt(1 + np.tan(x) ** 2 + np.tan(y) ** 2)
    # The line of sight lies in the x-z plane; components of the drop's axis along v and h.
    along_v = axis[2] * np.sin(angle_rad) - axis[0] * np.cos(angle_rad)
    along_h = axis[1]
    phasor = (along_v + 1j * along_h) ** 2  # sin^2 of the angle to the axis, times exp(2 j a)
    angle_to_axis = np.arcsin(np.sqrt(np.minimum(np.abs(phasor), 1.0)))
    level = np.interp(angle_to_axis, LOOKS_RAD, power)
    return np.array(
        [
            np.sum(weights * phasor.real * np.interp(angle_to_axis, LOOKS_RAD, mean)),
            np.sum(weights * phasor.real**2 * level),
            np.sum(weights * phasor.imag**2 * level),
        ]
    )


@dataclass(frozen=True, kw_only=True)
class EchoSpeeds:
    """Echo-weighted fall speeds of particles.

    cumulative: cumulative fraction of the reflectivity, from 0 to 1; speed_mps: the fall speed at this quantile.
    """

    cumulative: Float[np.ndarray, " node"]
    speed_mps: Float[np.ndarray, " node"]

    def at(self, quantile: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """Return fall speeds at quantiles: uniform quantiles sample particles weighted by their echo."""
        return np.interp(quantile, self.cumulative, self.speed_mps)


# Particles of some micrometres fall by centimetres per second.
FLOATING = EchoSpeeds(cumulative=np.array([0.0, 1.0]), speed_mps=np.zeros(2))


def weighted_speeds(weight: Float[np.ndarray, " node"], speed_mps: Float[np.ndarray, " node"]) -> EchoSpeeds:
    """Return the fall speeds of particle sizes, weighted by the echo of each size."""
    cumulative = np.cumsum(weight) - weight / 2  # each node is in the middle of its weight
    return EchoSpeeds(
        cumulative=np.concatenate([[0.0], cumulative / weight.sum(), [1.0]]),
        speed_mps=np.concatenate([speed_mps[:1], speed_mps, speed_mps[-1:]]),
    )


@dataclass(frozen=True, kw_only=True)
class SpeedMixture:
    """The fall speeds of several kinds of particles in one volume.

    fraction: fraction of each kind in the reflectivity, summing to 1.
    """

    fraction: tuple[float, ...]
    kinds: Sequence[EchoSpeeds]

    def at(self, quantile: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return fall speeds at quantiles below 1: one interval for each kind, spread over that kind's speeds."""
        edges = np.concatenate([[0.0], np.cumsum(self.fraction)[:-1], [1.0]])
        kind = np.searchsorted(edges[1:-1], quantile, side="right")
        speed = np.empty_like(quantile)
        for index, speeds in enumerate(self.kinds):
            rows = kind == index
            start, stop = edges[index], edges[index + 1]
            speed[rows] = speeds.at((quantile[rows] - start) / (stop - start))
        return speed
