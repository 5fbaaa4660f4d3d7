"""The part of a beam that fixed scatterers fill: an ellipse of direction cosines around its axis."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from sionna_radar.foundation.kept_values import KeptValues, Same
from sionna_radar.radar.antenna import Antenna, Cut
from sionna_radar.radar.two_way_grid import TwoWayGrid

# Share of the two-way power outside the ellipse. A beam with side lobes of -20 dB is 28 dB down there.
OUTSIDE_SHARE = 2e-3
# Shape of the ellipse: what reaches as far to either side as all but this share of the power.
SHAPE_SHARE = 3e-4
# Half axes over the half-power widths, at most: strong side lobes are left out.
WIDEST = 1.25
# Edges of either kind along each cut of a separable antenna.
EDGES = 200


@dataclass(frozen=True)
class FilledBeam:
    """Directions with (left / a)^2 + (up / b)^2 at most one, in front of the antenna.

    left, up: the half axes a and b, direction cosines.
    """

    left: float
    up: float

    def holds(self, direction: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Return which unit vectors in the antenna's frame it holds."""
        ahead, left, up = direction.T
        inside: Bool[np.ndarray, " n"] = (ahead > 0) & ((left / self.left) ** 2 + (up / self.up) ** 2 <= 1.0)
        return inside

    @property
    def solid_angle_sr(self) -> float:
        """Its size, for narrow beams."""
        return float(min(np.pi * self.left * self.up, 2 * np.pi))


# Surveys in a row look through the same antenna, and an electronic scan through several.
_BEAMS, _GRIDS = KeptValues(64), KeptValues(2)


def filled_beam(antenna: Antenna) -> FilledBeam:
    """Return the part of an antenna's beam that scatterers fill."""
    return _BEAMS.once(Same(antenna), lambda: _filled_beam(antenna))


def _filled_beam(antenna: Antenna) -> FilledBeam:
    grid = power_grid(antenna)
    left, up = grid.reach(SHAPE_SHARE)
    ahead, across, along = grid.direction.T
    away = np.where(ahead > 0, np.hypot(across / left, along / up), np.inf)
    order = np.argsort(away)
    below = np.cumsum(grid.power_sr.ravel()[order])
    scale = away[order][np.searchsorted(below, (1 - OUTSIDE_SHARE) * below[-1])]
    widest = WIDEST * np.array(antenna.beamwidths_rad) if antenna.separable else np.full(2, np.inf)
    return FilledBeam(float(min(scale * left, widest[0])), float(min(scale * up, widest[1])))


def power_grid(antenna: Antenna) -> TwoWayGrid:
    """Return the two-way power in front of an antenna, for a separable one from its cuts."""
    return _GRIDS.once(Same(antenna), lambda: _separable_grid(antenna)) if antenna.separable else antenna.two_way


def _separable_grid(antenna: Antenna) -> TwoWayGrid:
    (left, across), (up, along) = (_cells(cut) for cut in (antenna.azimuth, antenna.elevation))
    middle = ((left[1:] + left[:-1]) / 2) ** 2 + (((up[1:] + up[:-1]) / 2) ** 2)[:, None]
    # G^2 dOmega = A^4 E^4 cos^2 du dv / cos.
    power = np.outer(along, across) * np.sqrt(np.maximum(1 - middle, 0.0))
    return TwoWayGrid(left=left, up=up, power_sr=power, R_face_antenna=np.eye(3))


def _cells(cut: Cut) -> tuple[Float[np.ndarray, " edge"], Float[np.ndarray, " cell"]]:
    """Return edges, half of them by equal shares of the one-way power, and the two-way power between them."""
    cosine = cut.cosine
    below = np.concatenate([[0.0], np.cumsum((cut.voltage[1:] ** 2 + cut.voltage[:-1] ** 2) / 2)])
    rising = np.concatenate([[True], np.diff(below) > 0])
    shares = np.interp(np.linspace(0, below[-1], EDGES + 1)[1:-1], below[rising], cosine[rising])
    edges = np.unique(np.concatenate([shares, np.linspace(-1.0, 1.0, EDGES + 1)]))
    return edges, np.diff(np.interp(edges, cosine, cut.two_way_distribution))
