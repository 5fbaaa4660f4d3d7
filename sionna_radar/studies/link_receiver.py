"""What a receiver as built does to mean spectra: its reference, its anti-alias filter, unlike parts of I/Q samples.

A reference that is off scales all ranges. Sampling reads every frequency that is a whole number of sampling rates from
a bin's as the bin's own, and the anti-alias filter weighs each by its response; the calibration divides by the
high-pass in the bin, whatever it let pass of them. Parts of I/Q samples that differ leave an image of each beat f at
f_s - f. Stages of a plug-in are taken for ideal ones.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Complex, Float, Int

from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.signal.anti_alias import AntiAlias
from sionna_radar.signal.converter import Converter, Imbalance
from sionna_radar.signal.filters import Filters
from sionna_radar.signal.mixer import Mixer
from sionna_radar.signal.receiver import Receiver

# Powers at frequencies, which are counted in bins.
Spectrum = Callable[[Int[np.ndarray, " bin"]], Float[np.ndarray, " bin"]]
# Of what the high-pass leaves in a bin, by which the calibration divides.
LEAST_PASSED = 1e-12


@dataclass(frozen=True)
class Alias:
    """Frequencies that are read as those of the bins, counted in bins, and what of their power is read there."""

    number: Int[np.ndarray, " bin"]
    share: Float[np.ndarray, " bin"]


@dataclass(frozen=True)
class BuiltReceiver:
    """A receiver in closed form, and what makes spectra of its samples."""

    receiver: Receiver
    analyser: SpectrumAnalyser

    @property
    def scale(self) -> float:
        """Ranges that are read over true ones."""
        return next((stage.oscillator.scale for stage in self._stages if isinstance(stage, Mixer)), 1.0)

    @cached_property
    def aliases(self) -> tuple[Alias, ...]:
        """The bins' own frequencies, and those that fold onto them; real signals have both signs of each."""
        analyser, own = self.analyser, np.arange(len(self.analyser.range_m))
        chain, anti_alias = self.receiver.chain, self._anti_alias
        if chain is None or anti_alias is None:
            return (Alias(own, np.ones(len(own))),)
        chirp, high_pass = analyser.chirp, analyser.high_pass
        (lowest_hz, end_hz), period = chain.grid(chirp).band_hz, chirp.samples * analyser.zero_padding
        found, most = [], chain.oversampling // 2
        for turn in range(-most, most + 1):
            number = own + turn * period
            beat_hz = number * (chirp.sampling_rate_hz / period)
            share = np.where(
                (beat_hz >= lowest_hz) & (beat_hz < end_hz), np.abs(anti_alias.response(beat_hz)) ** 2, 0.0
            )
            if turn and high_pass is not None:
                share *= high_pass.power_response(beat_hz) / np.maximum(analyser.passed_power, LEAST_PASSED)
            found.append(Alias(np.abs(number) if chirp.sampling == "real" else number, share))
        return tuple(found)

    @property
    def reach(self) -> int:
        """Bins from zero on, those beyond the sampled band too, of which anything is read."""
        return 1 + max(int(alias.number[alias.share > 0].max(initial=-1)) for alias in self.aliases)

    def sampled(self, power: Spectrum) -> Float[np.ndarray, " bin"]:
        """Return the spectrum that is read of one in front of the filters, given at frequencies in bins."""
        read = np.zeros(len(self.analyser.range_m))
        for alias in self.aliases:
            read += alias.share * power(alias.number)
        if self.imbalance is None:
            return read
        passed = np.maximum(self.analyser.passed_power, LEAST_PASSED)
        # The image of the n-th bin is the n-th from the end of the band, which is that of zero.
        image = np.roll((read * passed)[::-1], 1) / passed
        return abs(self.imbalance.own) ** 2 * read + abs(self.imbalance.image) ** 2 * image

    def tones(self, beat_hz: Float[np.ndarray, " tone"]) -> Complex[np.ndarray, " tone"]:
        """Return the response of all filters to beats."""
        response = np.ones(len(beat_hz), dtype=np.complex128)
        for each in (self.analyser.high_pass, self._anti_alias):
            response = response if each is None else response * each.response(beat_hz)
        return response

    @property
    def imbalance(self) -> Imbalance | None:
        """Of the parts of I/Q samples; None for like ones."""
        return next((stage.imbalance for stage in self._stages if isinstance(stage, Converter)), None)

    @property
    def _anti_alias(self) -> AntiAlias | None:
        return next((stage.anti_alias for stage in self._stages if isinstance(stage, Filters)), None)

    @property
    def _stages(self) -> tuple[object, ...]:
        return () if self.receiver.chain is None else self.receiver.chain.stages
