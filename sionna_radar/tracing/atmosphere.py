"""What stands between the radar and the scene: the loss on every path, and the rain's own echo."""

import dataclasses

import numpy as np
from jaxtyping import Float
from scipy.constants import speed_of_light

from sionna_radar.flight.pulses import Pose, Pulses
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scenario.weather import WeatherTable
from sionna_radar.tracing.paths import Paths
from sionna_radar.tracing.rain import RainEcho
from sionna_radar.weather.conditions import Weather
from sionna_radar.weather.gases import Air
from sionna_radar.weather.path import two_way_attenuation


class Atmosphere:
    """The weather as one radar sees it."""

    def __init__(self, weather: Weather, antenna: Antenna, chirp: Chirp, seed: int) -> None:
        self._weather, self._antenna = weather, antenna
        raining = weather.rain_rate_mm_per_h > 0
        self._rain = RainEcho(weather, antenna, chirp, seed) if raining else None

    def with_rain(self, paths: Paths, pulses: Pulses) -> Paths:
        """Return a block's diffuse paths and the echo of the rain in front of them."""
        return paths if self._rain is None else Paths.concatenate([paths, self._rain.trace(pulses, paths)])

    def through(self, paths: Paths, pulses: Pulses) -> Paths:
        """Return a block's paths with the loss on their way; clear air changes nothing."""
        if self._weather.clear:
            return paths
        loss = self.attenuation_db_per_km(pulses.true)[np.searchsorted(pulses.index, paths.pulse)]
        left = two_way_attenuation(paths.delay_s * (speed_of_light / 2), loss)
        return dataclasses.replace(paths, gain=paths.gain * np.sqrt(left))

    def attenuation_db_per_km(self, pose: Pose) -> Float[np.ndarray, " pulse"]:
        """Return the one-way specific attenuation along the boresight.

        Rain weakens a horizontal field more. With the field e, the boresight d and z up, the tilt of e from the
        horizontal axis h = z x d / |z x d| and the elevation of d make cos^2(el) cos(2 tilt) =
        2 (e . z x d)^2 - (1 - d_z^2), which needs no axis straight down. V and H have it opposite, so that a circular
        wave has the difference of their shares of it: none.
        """
        field = pose.R_world_antenna[:, :, 1 if self._antenna.polarization == "H" else 2]
        d = pose.boresight
        across = field[:, 1] * d[:, 0] - field[:, 0] * d[:, 1]
        mix = 2 * across**2 - (1 - d[:, 2] ** 2)
        if self._antenna.circular:
            mix *= np.diff(np.abs(self._antenna.jones[0][::-1]) ** 2)
        return self._weather.attenuation_db_per_km(mix)


def build_atmosphere(table: WeatherTable, antenna: Antenna, chirp: Chirp, seed: int) -> Atmosphere:
    """Return the weather of a scenario as its radar sees it."""
    return Atmosphere(build_weather(table, chirp.carrier_hz), antenna, chirp, seed)


def build_weather(table: WeatherTable, carrier_hz: float) -> Weather:
    """Return the weather of a scenario at a carrier."""
    air = Air(
        dry_pressure_pa=100 * table.dry_pressure_hpa,
        temperature_k=table.temperature_k,
        vapour_density_g_per_m3=table.vapour_g_per_m3,
    )
    return Weather(
        carrier_hz=carrier_hz,
        rain_rate_mm_per_h=table.rain_rate_mm_per_h,
        liquid_water_g_per_m3=table.water_in_air_g_per_m3,
        air=air if table.gases else None,
        temperature_k=table.temperature_k,
    )
