"""The floors under an echo: what noise, leakage, oscillator and converter leave in each range cell, in closed form.

All are mean powers in bins of the calibrated spectrum, on the scale of the transmitted power. A power density S (of one
side, W/Hz) leaves S f_s sum w^2 in a bin, w the weights of the window with a sum of one: that is the noise bandwidth of
a cell. A tone of power P and delay tau leaves, beside itself, 4 sin^2(pi f tau) L(f) P at the offset f from its beat.
What leaks has nearly no beat, and a phase of its own: of a real signal the two side bands of the oscillator's noise
meet in the same cells, and what is in phase with the leakage does not change it. So its waves are followed one by one.
"""

import numpy as np
from jaxtyping import Complex, Float, Int
from scipy.constants import speed_of_light
from scipy.signal import fftconvolve

from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.scenario.radar import RadarTable
from sionna_radar.scenario.receiver import LeakageTable
from sionna_radar.signal.beat import phase_polynomial
from sionna_radar.signal.oscillator import PhaseNoise
from sionna_radar.signal.receiver import Receiver
from sionna_radar.signal.rounding import rounding_step
from sionna_radar.studies.link_receiver import LEAST_PASSED, BuiltReceiver

THERMAL, ROUNDING = "thermal noise", "rounding of the converter"
# Of the window around a tone, in range cells.
NEAR_CELLS = 32
# Powers over the greatest one below which a tone's phase noise is left out.
NO_TONE = 1e-6
LEAKAGE, LEAKAGE_NOISE = "leakage", "phase noise of the leakage"


def floors_of(
    radar: RadarTable, receiver: Receiver, analyser: SpectrumAnalyser
) -> dict[str, Float[np.ndarray, " bin"]]:
    """Return the floors of a radar that hears no echo, by their names; those that it does not have are left out.

    Rounding is taken for white noise, which it is where signal or noise exceed a step; that of a gain control is left
    out, since it depends on what is received. Stages of a plug-in are taken for ideal ones.
    """
    built = BuiltReceiver(receiver, analyser)
    noise_w = receiver.noise_power_w * in_cell(analyser)
    found = {THERMAL: built.sampled(lambda number: np.full(len(number), noise_w))}
    step = rounding_step(radar, receiver)
    if step is not None:
        parts = 1 if receiver.chirp.sampling == "real" else 2
        # It comes behind the high-pass, whose response the calibration divides out.
        found[ROUNDING] = parts * step**2 / 12 * in_cell(analyser) / np.maximum(analyser.passed_power, LEAST_PASSED)
    ways = radar.receiver.leakage
    if ways and "leakage" not in radar.receiver.stages:
        found[LEAKAGE] = _still(ways, radar, built)
        if radar.receiver.oscillator.levels_dbc_hz:
            found[LEAKAGE_NOISE] = _leakage_noise(ways, radar, built)
    return found


def in_cell(analyser: SpectrumAnalyser) -> float:
    """Return the power in a bin over that of white noise in a sample."""
    # A real beat's positive frequencies carry half of its power, and the calibration makes up for it.
    both = 2.0 if analyser.chirp.sampling == "real" else 1.0
    return float(both * np.sum(analyser.window**2))


def phase_noise(
    radar: RadarTable, built: BuiltReceiver, power_w: Float[np.ndarray, " reach"]
) -> Float[np.ndarray, " bin"]:
    """Return what the oscillator leaves, in all bins, of tones at the ranges of bins, those beyond the band too."""
    levels, analyser = radar.receiver.oscillator.levels_dbc_hz, built.analyser
    chirp = analyser.chirp
    if not levels:
        return np.zeros(len(analyser.range_m))
    noise, tone_m = PhaseNoise(levels), np.arange(len(power_w)) * analyser.bin_m
    tone_hz, own = tone_m * chirp.beat_per_metre_hz, np.flatnonzero(power_w > NO_TONE * power_w.max())

    def density(number: Int[np.ndarray, " bin"]) -> Float[np.ndarray, " bin"]:
        beat_hz, left = number * analyser.bin_m * chirp.beat_per_metre_hz, np.zeros(len(number))
        for tone in own:
            delay_s = 2 * tone_m[tone] / speed_of_light
            # A real beat's negative frequencies are folded onto positive ones.
            for sign in (-1, 1) if chirp.sampling == "real" else (-1,):
                offset_hz = np.abs(beat_hz + sign * tone_hz[tone])
                left += power_w[tone] * 4 * np.sin(np.pi * offset_hz * delay_s) ** 2 * noise.density(offset_hz)
        return left

    return built.sampled(density) * chirp.sampling_rate_hz * float(np.sum(analyser.window**2))


def _still(ways: tuple[LeakageTable, ...], radar: RadarTable, built: BuiltReceiver) -> Float[np.ndarray, " bin"]:
    """Return the spectrum of what leaks through an oscillator without phase noise: the same in every chirp."""
    analyser, (delay_s, tone) = built.analyser, _tones(ways, radar, built.receiver, built.analyser)
    beat_hz = phase_polynomial(delay_s, np.zeros(len(ways)), analyser.chirp).frequency_hz
    beat = (tone * built.tones(beat_hz)[:, None]).sum(axis=0, keepdims=True)
    if built.imbalance is not None:
        beat = built.imbalance(beat)
    return analyser.power(beat if analyser.chirp.sampling == "iq" else np.sqrt(2) * beat.real)[0]


def _tones(
    ways: tuple[LeakageTable, ...], radar: RadarTable, receiver: Receiver, analyser: SpectrumAnalyser
) -> tuple[Float[np.ndarray, " way"], Complex[np.ndarray, "way sample"]]:
    """Return the delay of each way, as it is read, and its tone: of magnitude sqrt(W)."""
    chirp, level_db = analyser.chirp, np.array([way.level_db for way in ways])
    delay_s = radar.receiver.oscillator.scale * 1e-9 * np.array([way.delay_ns for way in ways])
    phase = phase_polynomial(delay_s, np.zeros(len(ways)), chirp)
    turns = phase.constant[:, None] + phase.frequency_hz[:, None] * chirp.sample_time_s
    return delay_s, np.sqrt(receiver.transmit_power_w * 10 ** (level_db[:, None] / 10)) * np.exp(2j * np.pi * turns)


def _leakage_noise(
    ways: tuple[LeakageTable, ...], radar: RadarTable, built: BuiltReceiver
) -> Float[np.ndarray, " bin"]:
    """Return what the oscillator's noise leaves of the leakage.

    A wave of its phase at the offset f changes the tone of each way by j (1 - exp(-2 pi j f tau)) times the wave, and
    the spectrum by that times the tone's own, moved by f; waves of different offsets add up in power.
    """
    analyser = built.analyser
    chirp, levels = analyser.chirp, radar.receiver.oscillator.levels_dbc_hz
    delay_s, tone = _tones(ways, radar, built.receiver, analyser)
    # A real beat is the cosine of its phase; the calibration makes up for its negative frequencies.
    change = 1j * tone if chirp.sampling == "iq" else -2 * tone.imag
    step_hz = chirp.sampling_rate_hz / (chirp.samples * analyser.zero_padding)
    reach = int(np.ceil(np.max(np.abs(delay_s)) * abs(chirp.slope_hz_s) / step_hz)) + NEAR_CELLS * analyser.zero_padding
    moved = np.arange(-reach, reach + 1)
    waves = np.exp(-2j * np.pi * np.outer(moved * step_hz, chirp.sample_time_s)) * analyser.window
    own = np.einsum("ws,ms->wm", change, waves)
    bins = max(int(np.abs(alias.number).max()) + 1 for alias in built.aliases)
    number = np.arange(-bins - 2 * reach, bins + 2 * reach + 1)
    offset_hz = number * step_hz
    density = PhaseNoise(levels).density(np.abs(offset_hz)) * step_hz
    gone = 1 - np.exp(-2j * np.pi * delay_s[:, None] * offset_hz)
    left = np.zeros(len(number) + len(moved) - 1)
    for a in range(len(ways)):
        for b in range(len(ways)):
            left += fftconvolve(density * gone[a] * np.conj(gone[b]), own[a] * np.conj(own[b])).real
    return built.sampled(lambda number: np.maximum(left[number + (bins + 3 * reach)], 0.0))
