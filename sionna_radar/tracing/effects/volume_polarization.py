"""Polarization of the echo of rain and snow: the share of it that the antenna's receive port accepts."""

import dataclasses

import numpy as np
from jaxtyping import Float

from sionna_radar.flight.pulses import Pose, Pulses
from sionna_radar.radar.antenna import Antenna
from sionna_radar.tracing.paths import Paths
from sionna_radar.weather.conditions import Weather
from sionna_radar.weather.drop_shapes import DropPolarization, drop_polarization, snow_polarization, spheres
from sionna_radar.weather.drops import marshall_palmer

# Rain given by a map only: the rate hardly affects the share.
TYPICAL_RATE_MM_PER_H = 10.0


class VolumePolarization:
    """The volume echo as received at the ports of an antenna; kinds of particles are combined."""

    def __init__(self, weather: Weather, antenna: Antenna) -> None:
        self._moments = _moments(weather)
        self._antenna = antenna

    def received(self, echo: Paths, pulses: Pulses) -> Paths:
        """Return the echo, given for a linear co-polar antenna, as received by this one."""
        share = self.share(pulses.true)[pulses.row_of(echo.pulse)]
        return dataclasses.replace(echo, gain=echo.gain * np.sqrt(share))

    def share(self, pose: Pose) -> Float[np.ndarray, " pulse"]:
        """Return the power received from boresight relative to that of a linear co-polar antenna."""
        ahead = pose.boresight
        across = np.stack([-ahead[:, 1], ahead[:, 0], np.zeros(len(ahead))], axis=1)
        size = np.linalg.norm(across, axis=1, keepdims=True)
        # Straight down any horizontal axis will do.
        across = np.where(size > 1e-9, across / np.maximum(size, 1e-9), np.array([1.0, 0.0, 0.0]))
        within = np.cross(ahead, across)
        antenna_axes = pose.R_world_antenna[:, :, [2, 1]]  # axes of V and H
        to_drops = np.stack([np.einsum("ni,nij->nj", axis, antenna_axes) for axis in (within, across)], axis=1)
        transmitted, received = (to_drops @ port for port in self._antenna.jones)
        return self._moments.power(np.arccos(np.clip(ahead[:, 2], -1.0, 1.0)), transmitted, received)


def _moments(weather: Weather) -> DropPolarization:
    """Return the moments of all kinds, weighted by their reflectivity; droplets and dust are spheres."""
    kinds = []
    if weather.rains:
        rate = weather.rain_rate_mm_per_h or TYPICAL_RATE_MM_PER_H
        drops = drop_polarization(weather.carrier_hz, marshall_palmer(rate), weather.temperature_k)
        kinds.append((weather.rain_echo(rate)[0], drops))
    hydrometeors = [snow_polarization(kind) for kind in weather.snowfall_mm_per_h]
    still = weather.still_echoes
    hydrometeors += [spheres()] * (len(still) - len(hydrometeors))
    kinds += [(level, moments) for (level, _), moments in zip(still, hydrometeors, strict=True)]
    share = np.array([level for level, _ in kinds])
    share /= share.sum()
    return DropPolarization(
        angle_rad=kinds[0][1].angle_rad,
        mean=share @ np.stack([moments.mean for _, moments in kinds]),
        upright=share @ np.stack([moments.upright for _, moments in kinds]),
        slanted=share @ np.stack([moments.slanted for _, moments in kinds]),
    )


def volume_polarization(weather: Weather, antenna: Antenna) -> VolumePolarization | None:
    """Return None for a linear co-polar antenna, for which the reflectivity is defined."""
    if not antenna.circular and antenna.receives == "co":
        return None
    return VolumePolarization(weather, antenna)
