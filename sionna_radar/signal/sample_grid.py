"""The finer and longer grid of times on which a receiver's beat is made before it is filtered and sampled."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Inexact

from sionna_radar.radar.chirp import Chirp


@dataclass(frozen=True)
class SampleGrid:
    """The samples of a sweep, a whole number of times as dense, and going on beyond both of its ends.

    The sweep goes on before its first sample, so that filters have settled by then.
    oversampling: points per sample.
    guard: samples before the first one, and after the last one.
    """

    chirp: Chirp
    oversampling: int = 1
    guard: int = 0

    @cached_property
    def wide(self) -> Chirp:
        """The sweep as if all points of the grid were its samples: same slope, same middle, other ends."""
        long = (self.chirp.samples + 2 * self.guard) / self.chirp.samples
        return replace(
            self.chirp,
            bandwidth_hz=self.chirp.bandwidth_hz * long,
            rate_hz=self.chirp.rate_hz / long,
            samples=self.oversampling * (self.chirp.samples + 2 * self.guard),
        )

    @property
    def band_hz(self) -> tuple[float, float]:
        """The lowest beat that the points hold, and the end of their band, in whose middle that of the samples is."""
        # Complex samples cover 0 to the sampling rate, real ones both signs of beats alike.
        middle = self.chirp.sampling_rate_hz / 2 if self.chirp.sampling == "iq" else 0.0
        half = self.oversampling * self.chirp.sampling_rate_hz / 2
        return middle - half, middle + half

    @property
    def first(self) -> int:
        """The point of the first sample."""
        return self.wide.samples // 2 - self.oversampling * (self.chirp.samples // 2)

    def sampled(self, points: Inexact[np.ndarray, "pulse point"]) -> Inexact[np.ndarray, "pulse sample"]:
        """Return what is sampled of a signal on the grid."""
        last = self.first + self.oversampling * self.chirp.samples
        return points[:, self.first : last : self.oversampling]

    @cached_property
    def taper(self) -> Float[np.ndarray, " point"]:
        """Weights that fade in over the outer half of the first guard, and out over that of the last."""
        rise = self.oversampling * (self.guard // 2)
        weights = np.ones(self.wide.samples)
        if rise:
            weights[:rise] = np.sin(np.pi / 2 * (np.arange(rise) + 0.5) / rise) ** 2
            weights[-rise:] = weights[:rise][::-1]
        return weights
