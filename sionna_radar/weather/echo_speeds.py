"""How fast falls what sends an echo: the distribution of the reflectivity over fall speed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, kw_only=True)
class EchoSpeeds:
    """How fast the particles fall that send the echo.

    share: of the reflectivity, cumulative from 0 to 1; speed_mps: the fall speed that this share stays below.
    """

    share: Float[np.ndarray, " node"]
    speed_mps: Float[np.ndarray, " node"]

    def at(self, quantile: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """Return fall speeds by their quantiles: evenly spread quantiles give particles as the echo weighs them."""
        return np.interp(quantile, self.share, self.speed_mps)


# Particles of some micrometres sink by centimetres a second.
FLOATING = EchoSpeeds(share=np.array([0.0, 1.0]), speed_mps=np.zeros(2))


def weighted_speeds(weight: Float[np.ndarray, " node"], speed_mps: Float[np.ndarray, " node"]) -> EchoSpeeds:
    """Return the fall speeds of particle sizes, weighted by what each size sends back."""
    below = np.cumsum(weight) - weight / 2  # a node stands in the middle of what it weighs
    return EchoSpeeds(
        share=np.concatenate([[0.0], below / weight.sum(), [1.0]]),
        speed_mps=np.concatenate([speed_mps[:1], speed_mps, speed_mps[-1:]]),
    )


@dataclass(frozen=True, kw_only=True)
class SpeedMixture:
    """The fall speeds of several kinds of particles in one volume.

    share: of the reflectivity that each kind sends, summing to 1.
    """

    share: tuple[float, ...]
    kinds: Sequence[EchoSpeeds]

    def at(self, quantile: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return fall speeds by quantiles below 1: one part of them for each kind, spread over that kind's speeds."""
        edges = np.concatenate([[0.0], np.cumsum(self.share)[:-1], [1.0]])
        kind = np.searchsorted(edges[1:-1], quantile, side="right")
        speed = np.empty_like(quantile)
        for number, speeds in enumerate(self.kinds):
            mine = kind == number
            low, high = edges[number], edges[number + 1]
            speed[mine] = speeds.at((quantile[mine] - low) / (high - low))
        return speed
