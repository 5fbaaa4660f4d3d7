"""Sweeps and antennas, and the power that comes back from a plane under them."""

import numpy as np

from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.array_antenna import taylor_cut
from sionna_radar.radar.chirp import Chirp
from worlds import GAMMA


def make_chirp(**changes: object) -> Chirp:
    """Return the sweep of the paper's Table 2, with what the test changes of it."""
    values = {"carrier_hz": 77e9, "bandwidth_hz": 500e6, "rate_hz": 360.0, "samples": 1024}
    return Chirp(**(values | changes))


def make_antenna(azimuth_deg: float, elevation_deg: float, polarization: str = "V") -> Antenna:
    azimuth, elevation = (taylor_cut(float(np.deg2rad(w)), -20.0) for w in (azimuth_deg, elevation_deg))
    return Antenna(azimuth, elevation, polarization)


def plane_power(
    antenna: Antenna, height_m: float, incidence_deg: float, scan_deg: float = 0.0, gamma: float = GAMMA
) -> float:
    """Received over sent power above a plane: the radar equation summed over azimuth and elevation angles.

    P = lambda^2 / (4 pi)^3 * integral of G^2 sigma0 / r^4 dA, sigma0 = gamma cos t, dA = r^2 dOmega / cos t.
    Written apart from `sionna_radar.radar.equation`: other coordinates, other nodes; four times as many nodes change
    it by 1e-5 dB.
    """
    width = max(antenna.beamwidths_rad)
    near, far = 3.0 * width, np.pi / 2
    grid = np.concatenate(
        [np.linspace(-far, -near, 100)[:-1], np.linspace(-near, near, 161), np.linspace(near, far, 100)[1:]]
    )
    azimuth, elevation = np.meshgrid(grid, grid, indexing="ij")
    x, y, z = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)
    gain = antenna.gain(np.stack([x, y, z], axis=-1).reshape(-1, 3)).reshape(x.shape)
    # Downward components of boresight, left and up under a whisk-broom scan.
    a, b = np.deg2rad([incidence_deg, scan_deg])
    down = np.cos(a) * np.cos(b) * x + np.sin(b) * y - np.sin(a) * np.cos(b) * z
    range_m = height_m / np.maximum(down, 1e-4)
    # sigma0 dA / r^4 = gamma down * r^2 dOmega / down / r^4, and dOmega = cos(elevation) d azimuth d elevation.
    density = np.where(down > 1e-4, gain**2 * gamma / range_m**2 * np.cos(elevation), 0.0)
    wavelength = 299_792_458.0 / 77e9
    return wavelength**2 / (4 * np.pi) ** 3 * float(np.trapezoid(np.trapezoid(density, grid, axis=1), grid))
