"""The radar equation over an extended plane, by quadrature over the beam."""

import numpy as np
from jaxtyping import Float

from sionna_radar.flight.frames import whisk_broom_from_antenna
from sionna_radar.radar.antenna import Antenna, Cut
from sionna_radar.surfaces.backscatter import Backscatter

NODES = 256


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

    Parameters
    ----------
    antenna, backscatter:
        The beam, and the backscatter of the plane.
    wavelength_m, height_m:
        Wavelength, and height above the plane.
    incidence_rad:
        Angle of the boresight from nadir.

    """
    if not antenna.separable:
        grid = antenna.two_way
        down = grid.direction @ whisk_broom_from_antenna(incidence_rad, np.zeros(1))[0, 2]
        seen = (down > 1e-3) & (grid.power_sr.ravel() > 0)
        sigma0 = backscatter.sigma0(np.arccos(np.minimum(down[seen], 1.0)))
        echo = grid.power_sr.ravel()[seen] @ (sigma0 * down[seen]) / height_m**2
        return float(wavelength_m**2 / (4 * np.pi) ** 3 * antenna.peak_gain**2 * echo)
    u, v = np.meshgrid(_equal_shares(antenna.azimuth), _equal_shares(antenna.elevation))
    cos = np.sqrt(np.maximum(1 - u**2 - v**2, 0.0))
    down = whisk_broom_from_antenna(incidence_rad, np.zeros(1))[0, 2] @ np.array([cos.ravel(), u.ravel(), v.ravel()])
    seen = (down > 1e-3) & (cos.ravel() > 0)
    incidence = np.arccos(down[seen])
    range_m = height_m / down[seen]
    # G^2 dOmega = G0^2 (A E)^4 cos^2 du dv / cos, and the shares integrate (A E)^4 du dv.
    integrand = backscatter.sigma0(incidence) / (range_m**2 * down[seen]) * cos.ravel()[seen]
    beam = antenna.peak_gain**2 * antenna.azimuth.two_way_integral * antenna.elevation.two_way_integral
    return float(wavelength_m**2 / (4 * np.pi) ** 3 * beam * integrand.sum() / u.size)


def two_way_beam_sr(antenna: Antenna) -> float:
    """Return Omega_2, the integral of (G/G0)^2 over the solid angle, side lobes included.

    (G/G0)^2 dOmega = (A E)^4 cos du dv over the disc of directions, summed at the midpoints of equal shares.
    """
    if not antenna.separable:
        return antenna.two_way.beam_sr
    u, v = np.meshgrid(_equal_shares(antenna.azimuth), _equal_shares(antenna.elevation))
    mean_cosine = np.sqrt(np.maximum(1 - u**2 - v**2, 0.0)).mean()
    return float(antenna.azimuth.two_way_integral * antenna.elevation.two_way_integral * mean_cosine)


def _equal_shares(cut: Cut) -> Float[np.ndarray, " node"]:
    """Return direction cosines that divide the two-way power of a cut into equal shares."""
    shares = (np.arange(NODES) + 0.5) / NODES
    return np.interp(shares, cut.two_way_distribution, cut.cosine)
