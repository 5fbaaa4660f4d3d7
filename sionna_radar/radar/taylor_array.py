"""Planar arrays with a Taylor taper, sized from their half-power beamwidths."""

from functools import cache

import numpy as np
from scipy.optimize import brentq

from sionna_radar.foundation.decibel import to_db
from sionna_radar.foundation.windows import taylor
from sionna_radar.radar.antenna import Antenna, Cut, register_antenna
from sionna_radar.scenario.radar import AntennaTable

# Low side lobes lengthen the array by up to 1.7 at the same number of elements: this keeps them within half a
# wavelength, and leaves a wide beam enough elements to shape its side lobes.
SPACING_WAVELENGTHS = 0.25
# The side lobes of a taper are below its peak.
HIGHEST_DESIGN_DB = -3.0


@cache
def taylor_cut(beamwidth_rad: float, side_lobe_db: float) -> Cut:
    """Return the cut of a line of elements, half a wavelength apart or closer, with a Taylor taper.

    The spacing is trimmed so that the half-power width is exact, and the taper's design level so that the
    measured side lobe is as requested. The number of nearly equal side lobes, nbar, is the least for which
    the taper falls monotonically (Taylor 1955, "Design of line-source antennas": nbar >= 2 A^2 + 1/2, with
    cosh(pi A) the voltage ratio).
    """
    design_db = side_lobe_db
    cut = _designed_cut(beamwidth_rad, design_db)
    for _ in range(3):
        if cut.side_lobe_level == 0.0:  # a beam too wide to have side lobes
            break
        wanted_db = design_db + (side_lobe_db - to_db(cut.side_lobe_level))
        if wanted_db > HIGHEST_DESIGN_DB:  # a side lobe truncated at the horizon does not depend on the taper
            break
        design_db = wanted_db
        cut = _designed_cut(beamwidth_rad, design_db)
    return cut


def _designed_cut(beamwidth_rad: float, side_lobe_db: float) -> Cut:
    ratio = np.arccosh(10 ** (-side_lobe_db / 20)) / np.pi
    nbar = max(2, int(np.ceil(2 * ratio**2 + 0.5)))
    # The half-power width of a line source of length L wavelengths is near 1 / L.
    elements = max(4, int(np.ceil(1.05 / beamwidth_rad / SPACING_WAVELENGTHS)))
    weights = taylor(elements, nbar, -side_lobe_db)
    weights /= weights.sum()
    place = (np.arange(elements) - (elements - 1) / 2) / elements
    half = beamwidth_rad / 2

    def miss(length: float) -> float:
        voltage = weights @ np.cos(2 * np.pi * length * place * np.sin(half))
        return float(voltage - np.sqrt(0.5 / np.cos(half)))

    length = brentq(miss, 0.1 / beamwidth_rad, 1.8 / beamwidth_rad)
    # Odd, so that boresight is a sample; 256 samples per lobe keep linear interpolation within 1e-5.
    u = np.linspace(-1.0, 1.0, 2 * int(np.ceil(256 * length)) + 1)
    voltage = np.zeros(len(u))
    for weight, x in zip(weights, length * place, strict=True):
        voltage += weight * np.cos(2 * np.pi * x * u)
    return Cut(voltage)


@register_antenna("taylor", AntennaTable)
def taylor_array(table: AntennaTable) -> Antenna:
    """Return the antenna of a scenario's table."""
    azimuth, elevation = table.beamwidths_rad
    return Antenna(
        taylor_cut(azimuth, table.side_lobe_db),
        taylor_cut(elevation, table.side_lobe_db),
        table.polarization,
        table.receive_polarization,
        table.axial_ratio_db,
    )
