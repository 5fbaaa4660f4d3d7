"""The floors under a weak echo, in closed form: what a real receiver leaves in each bin of its calibrated spectrum.

All are mean powers of a bin, on the scale of `SpectrumAnalyser.power`: a white density N of power per hertz gives
N f_s sum w^2. Phase noise of something strong, an echo or a leakage of power P and delay tau, is
P 4 sin^2(pi f tau) L(f) per hertz at the offset f from its beat; the beat of real samples has another at the negative
frequency.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.foundation.decibel import from_db
from sionna_radar.scenario.radar import RadarTable
from sionna_radar.signal.noise import transmit_power_w
from sionna_radar.signal.oscillator import PhaseNoise


@dataclass(frozen=True, kw_only=True)
class Floors:
    """Mean powers in the bins of a spectrum.

    thermal: of the receiver's noise.
    rounding: of a converter with a fixed full scale; zero without one, and with a gain control.
    leakage_phase, echo_phase: phase noise of what leaks, and of a strong echo.
    """

    range_m: Float[np.ndarray, " bin"]
    thermal: Float[np.ndarray, " bin"]
    rounding: Float[np.ndarray, " bin"]
    leakage_phase: Float[np.ndarray, " bin"]
    echo_phase: Float[np.ndarray, " bin"]

    @property
    def total(self) -> Float[np.ndarray, " bin"]:
        """All of them together."""
        whole: Float[np.ndarray, " bin"] = self.thermal + self.rounding + self.leakage_phase + self.echo_phase
        return whole


def floors(
    radar: RadarTable,
    analyser: SpectrumAnalyser,
    noise_power_w: float,
    echo_power_w: float = 0.0,
    echo_range_m: float = 0.0,
) -> Floors:
    """Return the floors of a radar.

    Parameters
    ----------
    radar, analyser:
        The radar and its spectrum.
    noise_power_w:
        Of a sample.
    echo_power_w, echo_range_m:
        A strong echo at a point, on the scale of the receiver; without a power there is none.

    """
    chirp, levels = analyser.chirp, radar.receiver.oscillator.levels_dbc_hz
    white = float(np.sum(analyser.window**2)) * (2 if chirp.sampling == "real" else 1)
    flat = np.ones(len(analyser.range_m))
    zero = 0.0 * flat
    leaked, echoed = zero, zero
    if levels:
        sent_w, metres = transmit_power_w(radar), chirp.propagation_mps / 2
        for way in radar.receiver.leakage:
            power_w = sent_w * from_db(way.level_db)
            leaked = leaked + _phase_noise(analyser, PhaseNoise(levels), power_w, 1e-9 * way.delay_ns)
        echoed = _phase_noise(analyser, PhaseNoise(levels), echo_power_w, echo_range_m / metres)
    return Floors(
        range_m=analyser.range_m,
        thermal=noise_power_w * white * flat,
        rounding=_rounding_w(radar, noise_power_w) * white / _passed(analyser),
        leakage_phase=leaked,
        echo_phase=echoed,
    )


def _phase_noise(
    analyser: SpectrumAnalyser, noise: PhaseNoise, power_w: float, delay_s: float
) -> Float[np.ndarray, " bin"]:
    """Return the side bands of a steady beat."""
    chirp = analyser.chirp
    bin_hz, own_hz = analyser.range_m * chirp.beat_per_metre_hz, abs(chirp.slope_hz_s) * delay_s
    offsets = [bin_hz - own_hz] + ([bin_hz + own_hz] if chirp.sampling == "real" else [])
    density = sum(4 * np.sin(np.pi * f * delay_s) ** 2 * noise.density(np.abs(f)) for f in offsets)
    floor: Float[np.ndarray, " bin"] = power_w * density * chirp.sampling_rate_hz * np.sum(analyser.window**2)
    return floor


def _rounding_w(radar: RadarTable, noise_power_w: float) -> float:
    """Return the mean square error of rounding a sample: a twelfth of a step's square in each part of it."""
    receiver, table = radar.receiver, radar.receiver.converter
    if table.bits is None or table.agc_headroom_db is not None:
        return 0.0
    if table.full_scale_dbm is not None:
        full_w = 1e-3 * from_db(table.full_scale_dbm - table.gain_db - receiver.amplifier_gain_db)
    else:
        assert table.full_scale_over_noise_db is not None  # bits come with a full scale
        full_w = noise_power_w * from_db(table.full_scale_over_noise_db)
    # A sine of the power P has two thirds of it under its full-scale steps: 12 * 2 P / (2 sqrt(2 P))^2 = 1.5.
    return full_w / (1.5 * 4.0**table.bits)


def _passed(analyser: SpectrumAnalyser) -> Float[np.ndarray, " bin"]:
    """Return the power response by which the calibration divides; what comes behind the filter is raised by it."""
    if analyser.high_pass is None:
        return np.ones(len(analyser.range_m))
    bin_hz = analyser.range_m * analyser.chirp.beat_per_metre_hz
    return np.maximum(analyser.high_pass.power_response(bin_hz), 1e-12)
