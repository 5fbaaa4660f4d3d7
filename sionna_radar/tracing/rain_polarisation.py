"""What an antenna's polarisation makes of rain's echo: the share of it that flattened drops return into its port."""

import numpy as np
from jaxtyping import Float

from sionna_radar.flight.pulses import Pose
from sionna_radar.radar.antenna import Antenna
from sionna_radar.weather.conditions import Weather
from sionna_radar.weather.drop_shapes import drop_polarisation
from sionna_radar.weather.drops import marshall_palmer


class RainPolarisation:
    """The rain of a weather as the ports of an antenna receive it."""

    def __init__(self, weather: Weather, antenna: Antenna) -> None:
        drops = marshall_palmer(weather.rain_rate_mm_per_h)
        self._moments = drop_polarisation(weather.carrier_hz, drops, weather.temperature_k)
        self._antenna = antenna

    def share(self, pose: Pose) -> Float[np.ndarray, " pulse"]:
        """Return the power received from the boresight's direction over that of a linear, co-polar antenna."""
        ahead = pose.boresight
        across = np.stack([-ahead[:, 1], ahead[:, 0], np.zeros(len(ahead))], axis=1)
        size = np.linalg.norm(across, axis=1, keepdims=True)
        # Straight down any horizontal axis will do.
        across = np.where(size > 1e-9, across / np.maximum(size, 1e-9), np.array([1.0, 0.0, 0.0]))
        within = np.cross(ahead, across)
        own = pose.R_world_antenna[:, :, [2, 1]]  # axes of V and H
        to_drops = np.stack([np.einsum("ni,nij->nj", axis, own) for axis in (within, across)], axis=1)
        sent, received = (to_drops @ port for port in self._antenna.jones)
        return self._moments.power(np.arccos(np.clip(ahead[:, 2], -1.0, 1.0)), sent, received)


def rain_polarisation(weather: Weather, antenna: Antenna) -> RainPolarisation | None:
    """Return None for a linear antenna that receives what it sends: the reflectivity is that of its echo."""
    if not antenna.circular and antenna.receives == "co":
        return None
    return RainPolarisation(weather, antenna)
