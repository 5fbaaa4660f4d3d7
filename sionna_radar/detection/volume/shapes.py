"""Profiles of a beam across a plane behind a volume: the ground's echo, and what is left of the volume's.

A plane's range grows with the angle off the beam's axis, the more the larger the incidence. Both profiles follow from
that one law and the two-way beam, spread by the window.
"""

from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d

from sionna_radar.detection.ranging.plane_fit import BeamProfile
from sionna_radar.flight.frames import MIN_GRAZING_SINE

WIDTHS_CELLS = np.geomspace(0.35, 14.0, 21)
# Samples per cell of shapes, and of the shift of the end of a volume from its ground; the largest shift in cells.
FINE = 4
LARGEST_SHIFT = 20


def echo_width(
    beam: BeamProfile, range_cells: Float[np.ndarray, "*place"], down: Float[np.ndarray, "*view"]
) -> Float[np.ndarray, "*both"]:
    """Return the standard deviation of the echo of level ground at ranges, in cells.

    down: cosine of the boresight's angle from nadir.
    """
    return np.asarray(range_cells * beam_sigma(beam) * level_tangent(down))


def beam_sigma(beam: BeamProfile) -> float:
    """Return the standard deviation of the two-way beam in the plane of incidence, rad."""
    return float(np.sqrt(beam.power @ beam.sine**2))


def level_tangent(down: Float[np.ndarray, "*view"]) -> Float[np.ndarray, "*view"]:
    """Return the tangent of the incidence on level ground, at nadir that of the beam's width across."""
    return np.asarray(np.sqrt(1 / np.maximum(down, MIN_GRAZING_SINE) ** 2 - 1 + 0.1))


def widths_up_to(width_cells: float) -> Float[np.ndarray, " width"]:
    """Return the widths of the echoes compared, in cells: `WIDTHS_CELLS`, continued as far as needed."""
    ratio = WIDTHS_CELLS[1] / WIDTHS_CELLS[0]
    more = max(int(np.ceil(np.log(width_cells / WIDTHS_CELLS[-1]) / np.log(ratio))), 0)
    return np.append(WIDTHS_CELLS, WIDTHS_CELLS[-1] * ratio ** np.arange(1, more + 1))


@lru_cache(maxsize=256)
def air_shapes(
    step: int,
    spread: float,
    half: int,
    ground_cell: int,
    widths: bytes,
    sine: bytes,
    beam_power: bytes,
    response: bytes,
) -> Float[np.ndarray, "width tap"]:
    """Return 1 - F of the drifting volume for all widths, spread by the window.

    step: drift in samples; spread: its standard deviation in cells.
    """
    angle, power, window = (np.frombuffer(buffer) for buffer in (sine, beam_power, response))
    place = np.arange(-half * FINE, half * FINE + 1) / FINE
    margin = len(window) // 2
    airs = []
    for range_cells in _plane_ranges(widths, ground_cell, angle, power):
        order = np.argsort(range_cells)
        met = np.cumsum(power[order]) - power[order] / 2
        air = 1 - np.interp(place - step / FINE, range_cells[order], met, left=0.0, right=1.0)
        air = gaussian_filter1d(air, spread * FINE + 1e-3, mode="nearest")
        airs.append(np.convolve(np.pad(air, margin, mode="edge"), window, "valid")[::FINE])
    return np.array(airs)


@lru_cache(maxsize=256)
def ground_shapes(
    half: int, ground_cell: int, widths: bytes, sine: bytes, beam_power: bytes, response: bytes
) -> Float[np.ndarray, "width tap"]:
    """Return the ground's f for all widths, spread by the window: over the volume's mean, which falls as r^-2, too."""
    angle, power, window = (np.frombuffer(buffer) for buffer in (sine, beam_power, response))
    edges = (np.arange(-half * FINE, half * FINE + 2) - 0.5) / FINE
    grounds = []
    for range_cells in _plane_ranges(widths, ground_cell, angle, power):
        order = np.argsort(range_cells)
        echo = power[order]
        echoed = np.cumsum(echo) - echo / 2
        ground = np.diff(np.interp(edges, range_cells[order], echoed, left=0.0, right=echo.sum()))
        ground = np.convolve(ground, window, "same")[::FINE]
        grounds.append(ground / ground.sum())
    return np.array(grounds)


def _plane_ranges(
    widths: bytes, ground_cell: int, angle: Float[np.ndarray, " sample"], power: Float[np.ndarray, " sample"]
) -> Iterator[Float[np.ndarray, " sample"]]:
    """Yield the ranges at which the beam meets a plane less that on its axis, in cells, for each width.

    The range of a plane at the incidence t is r cos(t) / cos(t + a) at the angle a off the axis: the echo's far side is
    longer than its near one. Its width is w = r s tan(t), s being that of the beam.
    """
    beam = np.sqrt(power @ angle**2)
    for width in np.frombuffer(widths):
        if ground_cell == 0:
            yield width * angle / beam
            continue
        incidence = min(np.arctan(width / (ground_cell * beam)), np.arccos(MIN_GRAZING_SINE))
        off_axis = np.minimum(incidence + angle, np.arccos(MIN_GRAZING_SINE))
        yield ground_cell * (np.cos(incidence) / np.cos(off_axis) - 1)
