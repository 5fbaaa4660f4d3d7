"""Ray directions inside a beam, drawn so that a few hundred rays represent the whole echo.

Most rays are drawn in proportion to the two-way power of the beam, a small share uniformly over the half sphere
in front of the antenna, for the side lobes. Within a pulse the rays form a low-discrepancy set (Halton), shifted
at random in each pulse (Cranley and Patterson 1976), which leaves every single ray random and makes the
pulse's total power far less noisy than independent rays would.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from sionna_radar.foundation.low_discrepancy import halton
from sionna_radar.radar.antenna import Cut

QUANTILES = 4096


@dataclass(frozen=True, kw_only=True)
class BeamSampler:
    """The rays of one pulse before its random shift.

    unit: low-discrepancy points of the unit square, one per ray; the first `beam_rays` follow the beam.
    """

    unit: Float[np.ndarray, "ray 2"]
    beam_rays: int

    @property
    def rays(self) -> int:
        """Rays per pulse."""
        return len(self.unit)

    @property
    def beam_share(self) -> float:
        """Share of the rays that follow the beam."""
        return self.beam_rays / self.rays


def beam_sampler(rays: int, side_lobe_share: float) -> BeamSampler:
    """Return the sampler of a number of rays; at least one goes to the side lobes."""
    wide_rays = max(1, round(rays * side_lobe_share))
    beam_rays = rays - wide_rays
    unit = np.concatenate([halton(beam_rays), halton(wide_rays)])
    return BeamSampler(unit=unit, beam_rays=beam_rays)


def quantiles_of(cut: Cut) -> Float[np.ndarray, " quantile"]:
    """Return the direction cosines of a cut at equally spaced probabilities of its two-way power.

    Between two of them the density is constant, and the weights of the rays use that density.
    """
    distribution = cut.two_way_distribution
    rising = np.concatenate([[True], np.diff(distribution) > 0])
    quantiles = np.interp(np.linspace(0, 1, QUANTILES + 1), distribution[rising], cut.cosine[rising])
    quantiles[[0, -1]] = -1.0, 1.0
    return quantiles
