"""Analogue-to-digital converter: I/Q imbalance, offset, gain control, clipping and quantisation.

Samples are returned on the scale of the antenna: the known gain in front of the converter is divided out.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Complex, Float

from sionna_radar.radar.chirp import Chirp
from sionna_radar.signal.stages import Received


@dataclass(frozen=True, kw_only=True)
class Imbalance:
    """I/Q imbalance: amplitude of the quadrature over that of the in-phase part, and its lag behind a quarter cycle.

    A tone gets an image at the negative frequency, |a|^2 / |b|^2 below it, of a, b = (1 +- g exp(-+ j lag)) / 2.
    """

    gain: float
    lag_rad: float

    def __call__(self, samples: Complex[np.ndarray, "pulse sample"]) -> Complex[np.ndarray, "pulse sample"]:
        """Apply the imbalance to samples."""
        mixed: Complex[np.ndarray, "pulse sample"] = samples * self.tone_gain
        mixed += np.conj(samples) * self.image_gain
        return mixed

    @property
    def tone_gain(self) -> complex:
        """Complex gain of a tone."""
        return complex(1 + self.gain * np.exp(-1j * self.lag_rad)) / 2

    @property
    def image_gain(self) -> complex:
        """Complex gain of its image."""
        return complex(1 - self.gain * np.exp(1j * self.lag_rad)) / 2


@dataclass(frozen=True, kw_only=True)
class Converter:
    """A converter.

    bits: None for one that does not round.
    full_scale_w: power of the full-scale sine, on the scale of the antenna; None with a gain control.
    over_noise: full scale relative to the noise of a sample, instead of `full_scale_w`.
    headroom: amplitude of the strongest sample over full scale, with a gain control; None for a fixed gain.
    offset: over the amplitude of full scale.
    """

    bits: int | None = None
    full_scale_w: float | None = None
    over_noise: float | None = None
    headroom: float | None = None
    offset: float = 0.0
    imbalance: Imbalance | None = None

    def __call__(self, received: Received) -> Received:
        """Return the received signal with digitized samples."""
        samples = received.signal
        if self.imbalance is not None:
            samples = self.imbalance(samples)
        if self.full_scale_w is None and self.over_noise is None and self.headroom is None:
            return replace(received, samples=samples)
        # Each part of complex samples has a converter.
        components = np.ascontiguousarray(samples).view(np.float64)
        full_scale = self._amplitude(components, received)
        codes, clipped = self._converted(components / full_scale + self.offset)
        saturated = clipped.reshape(*samples.shape, -1).any(axis=2).sum(axis=1)
        return replace(received, samples=(codes * full_scale).view(samples.dtype), saturated=saturated)

    def _amplitude(
        self, components: Float[np.ndarray, "pulse part"], received: Received
    ) -> Float[np.ndarray, "#pulse 1"]:
        """Return the full-scale amplitude in each sweep, on the scale of the antenna."""
        if self.headroom is not None:
            strongest = np.max(np.abs(components), axis=1, keepdims=True) / self.headroom
            return np.where(strongest > 0, strongest, 1.0)
        full_scale = self._full_scale(received.noise_power_w, received.chirp)
        assert full_scale is not None
        return np.full((1, 1), full_scale)

    def step(self, noise_power_w: float, chirp: Chirp) -> float | None:
        """Return the quantisation step; None without quantisation, and with a gain control."""
        full = self._full_scale(noise_power_w, chirp)
        return None if full is None or self.bits is None else full / 2.0 ** (self.bits - 1)

    def _full_scale(self, noise_power_w: float, chirp: Chirp) -> float | None:
        """Return the full-scale amplitude; None with a gain control, and without a full scale."""
        power_w = self.full_scale_w
        if power_w is None and self.over_noise is not None:
            power_w = self.over_noise * noise_power_w
        # A real tone of power P has the amplitude sqrt(2 P), each part of a complex one sqrt(P).
        return None if power_w is None else float(np.sqrt(power_w * (2 if chirp.sampling == "real" else 1)))

    def _converted(
        self, values: Float[np.ndarray, "pulse part"]
    ) -> tuple[Float[np.ndarray, "pulse part"], Bool[np.ndarray, "pulse part"]]:
        """Quantise values in units of full scale, and return the mask of clipped ones."""
        if self.bits is None:
            return np.clip(values, -1.0, 1.0), np.abs(values) > 1
        half_range = 2.0 ** (self.bits - 1)
        # A one-bit converter gives the sign: its two values lie half a step off zero.
        shift = 0.5 if self.bits == 1 else 0.0
        code = np.floor(values * half_range) if self.bits == 1 else np.rint(values * half_range)
        clipped = np.clip(code, -half_range, half_range - 1)
        return (clipped + shift) / half_range, clipped != code
