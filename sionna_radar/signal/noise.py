"""Thermal noise of the receiver."""

from dataclasses import replace

import numpy as np
from jaxtyping import Inexact, Int
from scipy.constants import Boltzmann

from sionna_radar.foundation.decibel import from_db
from sionna_radar.foundation.randomness import Stream, pulse_generators
from sionna_radar.foundation.threads import over_rows
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scenario.bases import StageParameters
from sionna_radar.scenario.radar import RadarTable
from sionna_radar.signal.stages import Received, ReceiverStage, StageInputs, register_receiver_stage


def transmit_power_w(radar: RadarTable) -> float:
    """Return the transmitted power; 1 if the scenario gives a signal-to-noise ratio instead."""
    return 1.0 if radar.transmit_power_dbm is None else 1e-3 * from_db(radar.transmit_power_dbm)


def noise_power(radar: RadarTable, chirp: Chirp, reference_echo: float) -> float:
    """Return the noise power of a sample.

    With a noise figure it is k T F times the sampled bandwidth. With `snr_db` it is that much below the
    reference echo, and constant over the survey like receiver noise.

    Parameters
    ----------
    radar, chirp:
        The radar and its sweep.
    reference_echo:
        Received over transmitted power of the echo that `snr_db` refers to.

    """
    if radar.snr_db is not None:
        return reference_echo / from_db(radar.snr_db)
    figure_db = radar.system_noise_figure_db
    assert figure_db is not None
    bandwidth = chirp.sampling_rate_hz / (1 if chirp.sampling == "iq" else 2)
    return Boltzmann * radar.temperature_k * from_db(figure_db) * bandwidth


def add_noise(
    beat: Inexact[np.ndarray, "pulse sample"],
    power: float,
    seed: int,
    pulse: Int[np.ndarray, " pulse"],
    channel: int = 0,
) -> Inexact[np.ndarray, "pulse sample"]:
    """Return beat signals with white Gaussian noise of a given power; complex signals get half of it in each part.

    Each pulse has its own generator, for each of several receivers by its `channel`; a zero signal gives the noise
    alone.
    """
    noisy = np.empty_like(beat)

    def add(first: int, last: int) -> None:
        generators = pulse_generators(seed, Stream.NOISE, pulse[first:last], channel)
        for row, clean, generator in zip(noisy[first:last], beat[first:last], generators, strict=True):
            parts = row.view(np.float64)  # a complex sample is two of these
            generator.standard_normal(out=parts)
            parts *= np.sqrt(power * len(row) / len(parts))
            row += clean

    over_rows(add, len(noisy))
    return noisy


@register_receiver_stage("noise", StageParameters)
def build_noise_stage(_: StageParameters, given: StageInputs) -> ReceiverStage:
    """Return the stage that adds thermal noise: the same as without other stages."""
    return noisy


def noisy(received: Received) -> Received:
    """Return what is received with thermal noise beside it; the sweeps of a pulse draw theirs at once."""
    kind = np.complex128 if received.chirp.sampling == "iq" else np.float64
    points = received.sweeps * received.chirp.samples * received.noise_points
    silence = np.zeros((len(received.pulses), points), dtype=kind)
    power_w = received.noise_power_w * received.noise_points
    noise = add_noise(silence, power_w, received.seed, received.pulses.index, received.channel)
    return replace(received, noise=np.split(noise, received.sweeps, axis=1)[received.sweep])
