"""Radar equation over an extended plane, by quadrature over the beam; near-field range of a volume echo."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from sionna_radar.flight.frames import whisk_broom_from_antenna
from sionna_radar.radar.antenna import Antenna, Cut
from sionna_radar.surfaces.backscatter import Backscatter

NODES = 256
# Least cosine of the incidence: closer to the horizon the echo is negligible.
MIN_DOWN = 1e-3


def plane_echo(
    antenna: Antenna,
    backscatter: Backscatter,
    wavelength_m: float,
    height_m: float,
    incidence_rad: float,
) -> float:
    """Return received over transmitted power for a beam over a horizontal plane.

    P / P_t = lambda^2 / (4 pi)^3 * integral of G^2 sigma0(t) / r^4 dA (Rouveure et al. 2017, eq. 5, summed
    over the plane), and the plane's element dA = r^2 dOmega / cos t. The nodes are the midpoints of equal
    shares of the two-way beam, which have equal weights; for a pattern that is not separable, the cells of its power.

    height_m: above the plane.
    incidence_rad: angle of the boresight from nadir.
    """
    cos_incidence, weight = _beam_quadrature(antenna, incidence_rad)
    if not antenna.separable:
        echo = weight @ (backscatter.sigma0(np.arccos(np.minimum(cos_incidence, 1.0))) * cos_incidence) / height_m**2
        return float(wavelength_m**2 / (4 * np.pi) ** 3 * antenna.peak_gain**2 * echo)
    integrand = (
        backscatter.sigma0(np.arccos(cos_incidence)) / ((height_m / cos_incidence) ** 2 * cos_incidence) * weight
    )
    beam = antenna.peak_gain**2 * antenna.azimuth.two_way_integral * antenna.elevation.two_way_integral
    return float(wavelength_m**2 / (4 * np.pi) ** 3 * beam * integrand.sum() / NODES**2)


@dataclass(frozen=True)
class PlaneEcho:
    """The echo of a horizontal plane, by directions of the beam.

    range_m: of each part; power: received over transmitted; beam_fraction: fraction of the two-way beam.
    """

    range_m: Float[np.ndarray, " part"]
    power: Float[np.ndarray, " part"]
    beam_fraction: Float[np.ndarray, " part"]


def plane_echo_contributions(
    antenna: Antenna, backscatter: Backscatter, wavelength_m: float, height_m: float, incidence_rad: float
) -> PlaneEcho:
    """Return the contributions of the directions of the beam that sum to `plane_echo`; see there."""
    cos_incidence, weight = _beam_quadrature(antenna, incidence_rad)
    beam_sr = two_way_beam_sr(antenna)
    if antenna.separable:
        weight = weight * (antenna.azimuth.two_way_integral * antenna.elevation.two_way_integral / NODES**2)
    sigma0 = backscatter.sigma0(np.arccos(np.minimum(cos_incidence, 1.0)))
    power = wavelength_m**2 / (4 * np.pi) ** 3 * antenna.peak_gain**2 * weight * sigma0 * cos_incidence / height_m**2
    return PlaneEcho(range_m=height_m / cos_incidence, power=power, beam_fraction=weight / beam_sr)


def two_way_beam_sr(antenna: Antenna) -> float:
    """Return Omega_2, the integral of (G/G0)^2 over the solid angle, side lobes included.

    (G/G0)^2 dOmega = (A E)^4 cos du dv over the disc of directions, summed at the midpoints of equal shares.
    """
    if not antenna.separable:
        return antenna.two_way.beam_sr
    u, v = np.meshgrid(_equal_power_cosines(antenna.azimuth), _equal_power_cosines(antenna.elevation))
    mean_cosine = np.sqrt(np.maximum(1 - u**2 - v**2, 0.0)).mean()
    return float(antenna.azimuth.two_way_integral * antenna.elevation.two_way_integral * mean_cosine)


def near_field_m(antenna: Antenna, wavelength_m: float) -> float:
    """Return the range r_n (m) of the law (r^2 + r_n^2)^-1 of a volume's echo, which is r^-2 far beyond it.

    By reciprocity a drop's echo is sigma lambda^2 / (4 pi) S^2 with the power density S for a transmitted power of one.
    Over a Gaussian beam of the Rayleigh range r_n the integral of S^2 is 1 / (lambda r_n (1 + (r / r_n)^2)). Far away
    it is G0^2 Omega_2 / (4 pi r)^2, and so

        r_n = lambda (G0 / 4 pi)^2 Omega_2.

    Diffraction from uniform, cosine and squared-cosine apertures follows that law within 0.3 dB beyond 2 r_n.
    """
    return wavelength_m * (antenna.peak_gain / (4 * np.pi)) ** 2 * two_way_beam_sr(antenna)


def _beam_quadrature(
    antenna: Antenna, incidence_rad: float
) -> tuple[Float[np.ndarray, " part"], Float[np.ndarray, " part"]]:
    """Return the cosine of the angle from nadir and the weight of each downward part of the beam.

    The weight is (G/G0)^2 dOmega; of equal shares of a separable beam, the projected aperture: G^2 dOmega =
    G0^2 (A E)^4 cos^2 du dv / cos, and the shares integrate (A E)^4 du dv.
    """
    to_nadir = whisk_broom_from_antenna(incidence_rad, np.zeros(1))[0, 2]
    if not antenna.separable:
        grid = antenna.two_way
        cos_incidence, power_sr = grid.direction @ to_nadir, grid.power_sr.ravel()
        visible = (cos_incidence > MIN_DOWN) & (power_sr > 0)
        return cos_incidence[visible], power_sr[visible]
    u, v = np.meshgrid(_equal_power_cosines(antenna.azimuth), _equal_power_cosines(antenna.elevation))
    cos = np.sqrt(np.maximum(1 - u**2 - v**2, 0.0)).ravel()
    cos_incidence = to_nadir @ np.array([cos, u.ravel(), v.ravel()])
    visible = (cos_incidence > MIN_DOWN) & (cos > 0)
    return cos_incidence[visible], cos[visible]


def _equal_power_cosines(cut: Cut) -> Float[np.ndarray, " node"]:
    """Return direction cosines that divide the two-way power of a cut into equal shares."""
    quantiles = (np.arange(NODES) + 0.5) / NODES
    return np.interp(quantiles, cut.two_way_distribution, cut.cosine)
