"""Fall speeds of scatterers: the distribution of the reflectivity over fall speed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, kw_only=True)
class EchoSpeeds:
    """Echo-weighted fall speeds of particles.

    share: cumulative share of the reflectivity, from 0 to 1; speed_mps: the fall speed below which this share lies.
    """

    share: Float[np.ndarray, " node"]
    speed_mps: Float[np.ndarray, " node"]

    def at(self, quantile: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """Return fall speeds at quantiles: uniform quantiles draw particles with their echo as weight."""
        return np.interp(quantile, self.share, self.speed_mps)


# Particles of some micrometres sink by centimetres per second.
FLOATING = EchoSpeeds(share=np.array([0.0, 1.0]), speed_mps=np.zeros(2))


def weighted_speeds(weight: Float[np.ndarray, " node"], speed_mps: Float[np.ndarray, " node"]) -> EchoSpeeds:
    """Return the fall speeds of particle sizes, weighted by the echo of each size."""
    below = np.cumsum(weight) - weight / 2  # each node is in the middle of its weight
    return EchoSpeeds(
        share=np.concatenate([[0.0], below / weight.sum(), [1.0]]),
        speed_mps=np.concatenate([speed_mps[:1], speed_mps, speed_mps[-1:]]),
    )


@dataclass(frozen=True, kw_only=True)
class SpeedMixture:
    """The fall speeds of several kinds of particles in one volume.

    share: share of each kind in the reflectivity, summing to 1.
    """

    share: tuple[float, ...]
    kinds: Sequence[EchoSpeeds]

    def at(self, quantile: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return fall speeds at quantiles below 1: one interval for each kind, spread over that kind's speeds."""
        edges = np.concatenate([[0.0], np.cumsum(self.share)[:-1], [1.0]])
        kind = np.searchsorted(edges[1:-1], quantile, side="right")
        speed = np.empty_like(quantile)
        for number, speeds in enumerate(self.kinds):
            mine = kind == number
            low, high = edges[number], edges[number + 1]
            speed[mine] = speeds.at((quantile[mine] - low) / (high - low))
        return speed
