"""The channels of a frame over range rate and range, and the place of a scatterer between their cells."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Complex, Float, Int


@dataclass(frozen=True, kw_only=True)
class FrameMap:
    """The channels of a frame over range rate and range.

    channel: complex amplitudes; a beat of power P in every chirp has that of P.
    noise: power of the noise in a channel of a cell.
    rate_mps: of the rows, folded; range_m: of the cells, not corrected for Doppler.
    """

    channel: Complex[np.ndarray, "rate range channel"]
    noise: float
    rate_mps: Float[np.ndarray, " rate"]
    range_m: Float[np.ndarray, " range"]

    @cached_property
    def power(self) -> Float[np.ndarray, "rate range"]:
        """Mean power of the channels."""
        return np.mean(np.abs(self.channel) ** 2, axis=2)

    def between(
        self,
        rate: Int[np.ndarray, " n"],
        cell: Int[np.ndarray, " n"],
        weights: Float[np.ndarray, " sample"],
        axis: Literal[0, 1],
    ) -> Float[np.ndarray, " n"]:
        """Return the offset of a single scatterer from its cell along an axis, in cells, at most half of one.

        By the difference of the amplitudes in the cells beside it over its own, the same in all channels, whose value
        for a scatterer d ahead is the window's: (W(d - 1) - W(d + 1)) / W(d), for a Hann window 6 d / (4 - d^2).

        weights: window along the axis: 0 for range rates, 1 for ranges.
        """
        # Phases of ranges count from the sample number N // 2, those of range rates and of responses from the middle.
        count = len(weights)
        turn = 1.0 if axis == 0 else np.exp(2j * np.pi * ((count - 1) / 2 - count // 2) / count)
        here = self.channel[rate, cell]
        before, after = (np.roll(self.channel, side, axis)[rate, cell] for side in (1, -1))
        gradient = np.einsum("nc,nc->n", here.conj(), after * turn - before * np.conj(turn)).real
        offset = gradient / np.maximum(np.sum(np.abs(here) ** 2, axis=1), 1e-300)
        # As finely as the window is sampled.
        ahead = np.linspace(-0.5, 0.5, len(weights) + 1)
        behind, at, beyond = (_response(weights, ahead + side) for side in (1, 0, -1))
        return np.interp(offset, ((beyond - behind) * at.conj()).real / np.abs(at) ** 2, ahead)


def _response(weights: Float[np.ndarray, " sample"], place: Float[np.ndarray, " n"]) -> Complex[np.ndarray, " n"]:
    """Return the amplitude that a scatterer at places in cells, counted from a cell, has in it; phases as in maps."""
    sample = np.arange(len(weights)) - (len(weights) - 1) / 2
    return np.exp(2j * np.pi * np.outer(place, sample) / len(weights)) @ weights
