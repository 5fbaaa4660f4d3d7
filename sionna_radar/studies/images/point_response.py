"""Measured widths of point targets in images: those isolated, steady and far brighter than the ground.

Target positions serve the evaluation of an image, like surveyed corner reflectors; imaging does not use them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from sionna_radar.scene.model import Target
from sionna_radar.studies.images.aperture import PixelGrid
from sionna_radar.studies.images.strip import SlantImage, Strip, half_power_width

# Half extent of the patch for measuring a target, in theoretical widths, and the samples per width.
PATCH_WIDTHS = 3.0
SAMPLES_PER_WIDTH = 8
# Minimum ratio of a measured target to the median around it. Speckle, exponential about 1.44 times its median,
# exceeds it once in 2^30 cells.
MIN_CONTRAST = 30.0
# Swerling cases that fluctuate from pulse to pulse: their images have no defined width.
UNSTEADY = (2, 4)


@dataclass(frozen=True, kw_only=True)
class Widths:
    """Half-power widths of a point along the track, and across it: in slant range (SLAR) or on the ground (SAR)."""

    along_m: float
    across_m: float


@dataclass(frozen=True, kw_only=True)
class Point:
    """A point target by its position relative to a track.

    along_m: along the track from below its start; ground_m: ground range from it, on the look side.
    height_m: world frame; slant_range_m, incidence_rad: from the nearest point of the track.
    """

    along_m: float
    ground_m: float
    height_m: float
    slant_range_m: float
    incidence_rad: float
    steady: bool


def relative_to_track(target: Target, strip: Strip) -> Point:
    """Return the position of a target relative to the track of a strip."""
    frame = strip.pixels(np.zeros(1), np.zeros(1))
    away = np.array(target.position_m) - frame.origin_m
    along, ground = float(away @ frame.along), float(away @ frame.across)
    drop = strip.clearance_m - float(away[2])
    return Point(
        along_m=along,
        ground_m=ground,
        height_m=target.position_m[2],
        slant_range_m=float(np.hypot(ground, drop)),
        incidence_rad=float(np.arctan2(ground, drop)),
        steady=target.swerling not in UNSTEADY and target.way is None and target.body is None and not target.rotors,
    )


def isolated(point: Point, others: Sequence[Point], theory: Widths) -> bool:
    """Return True if no other point is close enough to disturb this one's response."""
    return not any(
        other is not point
        and abs(other.along_m - point.along_m) < 2 * PATCH_WIDTHS * theory.along_m
        and abs(other.slant_range_m - point.slant_range_m) < 2 * PATCH_WIDTHS * theory.across_m
        for other in others
    )


def patch_around(point: Point, strip: Strip, theory: Widths) -> PixelGrid:
    """Return the pixels for measuring the focused response of a point, at the height of the point."""
    offset = np.arange(-PATCH_WIDTHS, PATCH_WIDTHS + 1e-9, 1 / SAMPLES_PER_WIDTH)
    return strip.pixels(
        point.along_m + offset * theory.along_m, point.ground_m + offset * theory.across_m, point.height_m
    )


def measured_in_patch(power: Float[np.ndarray, "row column"], patch: PixelGrid) -> Widths | None:
    """Return the widths of the point in the middle of a focused patch; None where it cannot be measured."""
    return _widths(power.T, patch.along_m, patch.across_m)


def measured_in_slant(image: SlantImage, point: Point, theory: Widths) -> Widths | None:
    """Return the widths of a point in a slant-range image; None where it cannot be measured."""
    along = np.abs(image.along_m - point.along_m) <= PATCH_WIDTHS * theory.along_m
    across = np.abs(image.range_m - point.slant_range_m) <= PATCH_WIDTHS * theory.across_m
    power = image.power[np.ix_(along, across)]
    if min(power.shape) < PATCH_WIDTHS or not np.isfinite(power).all():
        return None
    return _widths(power, image.along_m[along], image.range_m[across])


def _widths(
    power: Float[np.ndarray, "along across"],
    along_m: Float[np.ndarray, " along"],
    across_m: Float[np.ndarray, " across"],
) -> Widths | None:
    # The point is in the middle; anything brighter near the edge is another scatterer.
    skip = [size // 3 for size in power.shape]
    inner = power[skip[0] : -skip[0], skip[1] : -skip[1]]
    brightest = np.unravel_index(inner.argmax(), inner.shape)
    row, column = int(brightest[0]) + skip[0], int(brightest[1]) + skip[1]
    if power[row, column] < MIN_CONTRAST * np.median(power):
        return None
    cuts = ((along_m, power[:, column], row), (across_m, power[row], column))
    if any(cut.argmax() != peak for _, cut, peak in cuts):
        return None
    try:
        along, across = (half_power_width(place, cut) for place, cut, _ in cuts)
    except ValueError:  # a flank that does not fall to half belongs to another scatterer, too
        return None
    return Widths(along_m=along, across_m=across)
