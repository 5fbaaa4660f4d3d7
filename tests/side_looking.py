"""Flights past a point or a field, the beam to the right of the track."""

from dataclasses import dataclass

import numpy as np

from sionna_radar.flight.frames import R_WORLD_NED, conical_from_antenna
from sionna_radar.flight.pulses import Pose, Pulses
from sionna_radar.radar.antenna import Antenna, Cut
from sionna_radar.radar.array_antenna import taylor_cut
from sionna_radar.radar.chirp import Chirp

HEIGHT_M = 28.0
SPEED_MPS = 5.0
INCIDENCE_RAD = float(np.pi / 4)
RIGHT = np.pi / 2


@dataclass(frozen=True, kw_only=True)
class Flight:
    """What the tests fly: north along x = 0 at 28 m, looking east at 45 deg."""

    chirp: Chirp
    antenna: Antenna

    def pulses(self, half_length_m: float, *, every: int = 1) -> Pulses:
        count = int(2 * half_length_m * self.chirp.rate_hz / SPEED_MPS)
        index = np.arange(0, count, every)
        along = (index - count / 2) * SPEED_MPS / self.chirp.rate_hz
        zero = np.zeros(len(index))
        axes = R_WORLD_NED @ conical_from_antenna(INCIDENCE_RAD, np.full(len(index), RIGHT))
        pose = Pose(
            position_m=np.column_stack([zero, along, zero + HEIGHT_M]),
            velocity_mps=np.tile([0.0, SPEED_MPS, 0.0], (len(index), 1)),
            R_world_antenna=axes,
        )
        return Pulses(index=index, time_s=index / self.chirp.rate_hz, scan_rad=zero, true=pose, measured=pose)


def make_flight(
    azimuth_deg: float = 4.0, elevation_deg: float = 20.0, rate_hz: float = 1000.0, **chirp: object
) -> Flight:
    values = {"carrier_hz": 77e9, "bandwidth_hz": 500e6, "rate_hz": rate_hz, "samples": 256, "sampling": "iq"}
    azimuth, elevation = (taylor_cut(float(np.deg2rad(w)), -20.0) for w in (azimuth_deg, elevation_deg))
    return Flight(chirp=Chirp(**(values | chirp)), antenna=Antenna(azimuth, elevation))


def uniform_cut(length_m: float, wavelength_m: float) -> Cut:
    """Return the cut of a uniformly lit aperture: sin(pi d u / lambda) / (pi d u / lambda)."""
    return Cut(np.sinc(length_m / wavelength_m * np.linspace(-1.0, 1.0, 40_001)))
