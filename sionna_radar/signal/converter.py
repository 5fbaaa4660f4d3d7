"""The analogue-to-digital converter: errors of I/Q samples, gain, full scale, rounding and its step.

Samples are returned on the scale of the antenna: the known gain in front of the converter is divided out.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Complex, Float

from sionna_radar.foundation.numerics import from_db
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scenario.bases import StageParameters
from sionna_radar.scenario.radar import RadarTable
from sionna_radar.scenario.receiver import ConverterTable
from sionna_radar.signal.receiver import Receiver
from sionna_radar.signal.stages import Received, StageInputs


@dataclass(frozen=True, kw_only=True)
class Imbalance:
    """I/Q imbalance: amplitude of the quadrature over that of the in-phase part, and its lag behind a quarter cycle.

    A tone gets an image at the negative frequency, |a|^2 / |b|^2 below it, of a, b = (1 +- g exp(-+ j lag)) / 2.
    """

    gain: float
    lag_rad: float

    def __call__(self, samples: Complex[np.ndarray, "pulse sample"]) -> Complex[np.ndarray, "pulse sample"]:
        """Apply the imbalance to samples."""
        mixed: Complex[np.ndarray, "pulse sample"] = samples * self.own
        mixed += np.conj(samples) * self.image
        return mixed

    @property
    def own(self) -> complex:
        """Complex gain of a tone."""
        return complex(1 + self.gain * np.exp(-1j * self.lag_rad)) / 2

    @property
    def image(self) -> complex:
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


def build_converter(_: StageParameters, given: StageInputs) -> Converter:
    """Return the converter of a scenario's radar."""
    receiver = given.radar.receiver
    table = receiver.converter
    gain = from_db(receiver.amplifier_gain_db + table.gain_db)
    return Converter(
        bits=table.bits,
        full_scale_w=None if table.full_scale_dbm is None else 1e-3 * from_db(table.full_scale_dbm) / gain,
        over_noise=None if table.full_scale_over_noise_db is None else from_db(table.full_scale_over_noise_db),
        headroom=None if table.agc_headroom_db is None else from_db(-table.agc_headroom_db / 2),
        offset=0.0 if table.dc_offset_db is None else from_db(table.dc_offset_db / 2),
        imbalance=_imbalance(table),
    )


def _imbalance(table: ConverterTable) -> Imbalance | None:
    if not table.imbalanced:
        return None
    return Imbalance(gain=from_db(table.iq_gain_db / 2), lag_rad=float(np.deg2rad(table.iq_phase_deg)))


def rounding_step(radar: RadarTable, receiver: Receiver) -> float | None:
    """Return the step of the converter on the scale of the antenna; None for one without a fixed step."""
    if "converter" in radar.receiver.stages:
        return None
    inputs = StageInputs(radar=radar, sweeps=receiver.sweeps, high_pass=receiver.high_pass)
    converter = build_converter(StageParameters(stage="converter"), inputs)
    return converter.step(receiver.noise_power_w, receiver.chirp)


def rounding_over_noise(radar: RadarTable, receiver: Receiver) -> float | None:
    """Return the power of the rounding of a sample over that of its thermal noise; None without a fixed step."""
    step = rounding_step(radar, receiver)
    if step is None or receiver.noise_power_w == 0:
        return None
    components = 1 if receiver.chirp.sampling == "real" else 2
    return components * step**2 / 12 / receiver.noise_power_w
