"""What the anti-alias filter of a receiver, and the sampling behind it, make of mean spectra.

Beats are weakened by the filter's own response, and those beyond the sampled band fold into it: of a real signal every
second band the other way round; complex samples see one band, from zero to their rate. White noise folds from all bands
that the filter lets pass.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from sionna_radar.scenario.radar import RadarTable
from sionna_radar.signal.anti_alias import AntiAlias, build_anti_alias
from sionna_radar.signal.receiver import Receiver
from sionna_radar.signal.sample_grid import SampleGrid


@dataclass(frozen=True)
class Folding:
    """An anti-alias filter, and the grid of points whose samples are taken behind it."""

    anti_alias: AntiAlias
    grid: SampleGrid

    @property
    def bands(self) -> int:
        """Sampled bands that the points hold from zero on, one after the other; the last may be held in part."""
        band_hz = self.grid.chirp.sampling_rate_hz / (2 if self.grid.chirp.sampling == "real" else 1)
        return int(np.ceil(self.grid.band_hz[1] / band_hz))

    def passed(self, beat_hz: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the share of the power of beats that passes; none beyond the band of the points."""
        lowest, end = self.grid.band_hz
        response: Float[np.ndarray, " n"] = np.abs(self.anti_alias.response(beat_hz)) ** 2
        return np.where((beat_hz >= lowest) & (beat_hz < end), response, 0.0)

    def noise(self, beat_hz: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the power of white noise at beats of the sampled band, over that behind an ideal filter."""
        rate_hz = self.grid.chirp.sampling_rate_hz
        return np.sum([self.passed(beat_hz + k * rate_hz) for k in range(-self.bands, self.bands + 1)], axis=0)

    def sampled(self, fine: Float[np.ndarray, " fine"], steps: int, step_hz: float) -> Float[np.ndarray, " step"]:
        """Return powers in steps of beat within the sampled band, of powers from zero on.

        fine: in each step, from a beat of zero on. steps: of the sampled band.
        """
        number = np.arange(len(fine))
        band, within = np.divmod(number, steps)
        if self.grid.chirp.sampling == "real":
            within = np.where(band % 2 == 1, steps - within, within)
        return np.bincount(within, fine * self.passed(number * step_hz), minlength=steps + 1)[:steps]


def folding_of(radar: RadarTable, receiver: Receiver) -> Folding | None:
    """Return the anti-alias filter of a radar with what folds behind it; None for an ideal one, or a plug-in's."""
    anti_alias = build_anti_alias(radar.receiver, receiver.chirp)
    if anti_alias is None or receiver.chain is None or "filters" in radar.receiver.stages:
        return None
    return Folding(anti_alias, receiver.chain.grid(receiver.chirp))
