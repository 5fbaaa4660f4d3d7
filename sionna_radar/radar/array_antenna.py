"""Parts of array antennas: Taylor tapers, tables of elements, and the steered beams of an electronic scan.

`taylor_cut` sizes a line of elements by its half-power beamwidth and side-lobe level; an antenna of two such cuts needs
no table. `radar.build` assembles the antennas.
"""

from functools import cache
from pathlib import Path

import numpy as np
from jaxtyping import Complex, Float
from scipy.optimize import brentq

from sionna_radar.flight.scan import Scan
from sionna_radar.foundation.decibels import to_db
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.input_file import read_numbers, shown
from sionna_radar.foundation.windows import taylor
from sionna_radar.radar.antenna import Antenna, Cut
from sionna_radar.radar.array_pattern import ArrayPattern, steered

KEY = "radar.antenna.path"
COLUMNS = {"left_wavelengths": None, "up_wavelengths": None, "amplitude_db": 0.0, "phase_deg": 0.0}
MAX_ELEMENTS, LARGEST_WAVELENGTHS = 1_048_576, 300.0
REMEDY = "give a CSV with the columns left_wavelengths,up_wavelengths and, if wanted, amplitude_db,phase_deg"


def beams_of(antenna: Antenna, scan: Scan) -> tuple[Antenna, ...]:
    """Return the antenna of each beam of an electronic scan; none for a scan that moves the whole antenna.

    Raises ScenarioError for an antenna that cannot be steered, or already is.
    """
    azimuth = getattr(scan, "beam_azimuth_rad", None)
    if azimuth is None:
        return ()
    pattern = antenna.transmit
    if not isinstance(pattern, ArrayPattern):
        message = "'electronic' needs an array; set radar.antenna.kind = 'array', or another mode"
        raise ScenarioError.of("radar.scan.mode", message)
    if pattern.azimuth_rad or pattern.elevation_rad:
        message = "the electronic scan steers the beam itself; remove it, or tilt the face by radar.scan.incidence_deg"
        raise ScenarioError.of("radar.antenna.steer_deg", message)
    return tuple(steered(antenna, float(angle)) for angle in azimuth)


def line_taper(count: int, side_lobe_db: float | None) -> Float[np.ndarray, " element"]:
    """Return the Taylor weights of a line of elements for a level of its side lobes; None for equal weights."""
    if side_lobe_db is None or count < 3:
        return np.ones(count)
    ratio = np.arccosh(10 ** (-side_lobe_db / 20)) / np.pi
    nbar = max(2, int(np.ceil(2 * ratio**2 + 0.5)))
    return taylor(count, nbar, -side_lobe_db)


def read_elements(path: Path) -> tuple[Float[np.ndarray, "element 2"], Complex[np.ndarray, " element"]]:
    """Return places (left, up) in wavelengths and complex weights of a table of elements.

    Raises InputFileError for any other file.
    """
    name = f"{KEY} = {shown(path)}"
    left, up, amplitude_db, phase_deg = np.array(read_numbers(path, f"{KEY} =", COLUMNS, REMEDY)[1])
    if len(left) > MAX_ELEMENTS or np.abs([left, up, amplitude_db, phase_deg]).max() > 1e6:
        message = f"{name}: has {len(left):,} elements, or a number beyond 1e6; give at most {MAX_ELEMENTS:,} elements"
        raise InputFileError(message)
    if len(np.unique(np.round(np.column_stack([left, up]), 3), axis=0)) < len(left):
        raise InputFileError(f"{name}: has several elements at one place; give each its own, in wavelengths")
    return np.column_stack([left, up]), 10 ** (amplitude_db / 20) * np.exp(1j * np.deg2rad(phase_deg))


# Low side lobes lengthen the array by up to 1.7 at the same number of elements: this keeps them within half a
# wavelength, and leaves a wide beam enough elements to shape its side lobes.
SPACING_WAVELENGTHS = 0.25
# Samples of a cut whose cosines, half as many as there are elements, stay in a core's cache.
SAMPLES_AT_ONCE = 2048
# Highest design level of the side lobes.
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
    # The half-power width of a line source of length L wavelengths is near 1 / L.
    elements = max(4, int(np.ceil(1.05 / beamwidth_rad / SPACING_WAVELENGTHS)))
    weights = line_taper(elements, side_lobe_db)
    weights /= weights.sum()
    position = (np.arange(elements) - (elements - 1) / 2) / elements
    half_width_rad = beamwidth_rad / 2

    def error(length: float) -> float:
        voltage = weights @ np.cos(2 * np.pi * length * position * np.sin(half_width_rad))
        return float(voltage - np.sqrt(0.5 / np.cos(half_width_rad)))

    length = brentq(error, 0.1 / beamwidth_rad, 1.8 / beamwidth_rad)
    # Odd, so that boresight is a sample; 256 samples per lobe keep linear interpolation within 1e-5.
    u = np.linspace(-1.0, 1.0, 2 * int(np.ceil(256 * length)) + 1)
    phase_per_u = 2 * np.pi * (length * position)
    voltage = np.zeros(len(u))
    for low in range(0, len(u), SAMPLES_AT_ONCE):
        part = slice(low, low + SAMPLES_AT_ONCE)
        # Elements at the same distance from the middle have the same cosine.
        half = [np.cos(phase * u[part]) for phase in phase_per_u[: (elements + 1) // 2]]
        for weight, cosine in zip(weights, half + half[::-1][elements % 2 :], strict=True):
            voltage[part] += weight * cosine
    return Cut(voltage)
