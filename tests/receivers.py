"""Receivers of radars with some keys of `[radar.receiver]`."""

from collections.abc import Mapping
from typing import Any

from sionna_radar.detection.echoes import Echoes
from sionna_radar.flight.pulses import Pulses
from sionna_radar.radar.build import build_sweeps
from sionna_radar.scenario.radar import RadarTable
from sionna_radar.signal.build import build_chain, build_high_pass
from sionna_radar.signal.mixer import receiver_paths
from sionna_radar.signal.receiver import Receiver
from sionna_radar.tracing.paths import Paths


def radar_with(receiver: Mapping[str, Any] | None = None, **keys: Any) -> RadarTable:
    """Return a radar of 256 samples with a receiver that is not ideal."""
    noise = {} if "transmit_power_dbm" in keys else {"snr_db": 30.0}
    return RadarTable(**{**noise, "samples_per_chirp": 256, "receiver": dict(receiver or {}), **keys})


def receiver_of(radar: RadarTable, noise_w: float = 0.0) -> Receiver:
    """Return the receiver of a radar that sends one watt, with a noise power of its samples."""
    sweeps, high_pass = build_sweeps(radar), build_high_pass(radar.receiver)
    chain = build_chain(radar, sweeps, high_pass)
    return Receiver(
        sweeps=sweeps, transmit_power_w=1.0, noise_power_w=noise_w, seed=5, high_pass=high_pass, chain=chain
    )


def echoes_of_all(found: Any, paths: Paths, pulses: Pulses, noise_w: float) -> Echoes:
    """Return what an estimator of angles finds in the beats of all of its receivers."""
    receiver = Receiver(sweeps=(found.detector.analyser.chirp,), transmit_power_w=1.0, noise_power_w=noise_w, seed=4)
    sides = [
        receiver.beat(receiver_paths(paths, pulses, found.array, channel), pulses, channel)
        for channel in range(1, len(found.axes) + 1)
    ]
    echoes = found.find([receiver.beat(paths, pulses), *sides], pulses.index, pulses.measured)
    return found.detector.correct(echoes, pulses.index, pulses.measured)
