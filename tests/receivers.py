"""Receivers of radars with some keys of `[radar.receiver]`."""

from collections.abc import Mapping
from typing import Any

from sionna_radar.radar.build import build_sweeps
from sionna_radar.scenario.radar import RadarTable
from sionna_radar.signal.build import build_chain, build_high_pass
from sionna_radar.signal.receiver import Receiver


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
