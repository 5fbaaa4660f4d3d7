"""Propagation loss of every path in the atmosphere, and the volume echo of rain, snow, fog or dust."""

import dataclasses

import numpy as np
from jaxtyping import Float, Int
from scipy.constants import speed_of_light

from sionna_radar.flight.pulses import Pose, Pulses
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.tracing.effects.volume_echo import VolumeEcho, volume_polarization
from sionna_radar.tracing.paths import Paths
from sionna_radar.weather.conditions import Weather, volume_of
from sionna_radar.weather.path import two_way_attenuation
from sionna_radar.weather.rain import RainMap, rain_power_laws


class Atmosphere:
    """The weather as one radar sees it."""

    def __init__(self, weather: Weather, antenna: Antenna, chirp: Chirp, seed: int) -> None:
        self._weather, self._antenna = weather, antenna
        self._step_m = chirp.range_resolution_m
        self._steps = int(np.ceil(chirp.max_range_m / self._step_m))
        volume = volume_of(weather)
        self._echo = None if volume is None else VolumeEcho(volume, antenna, chirp, seed, weather.wind_mps)
        self._polarization = None if volume is None else volume_polarization(weather, antenna)

    @property
    def clear(self) -> bool:
        """Whether it takes nothing from paths and adds none."""
        return self._weather.clear and self._echo is None

    def with_volume(self, paths: Paths, pulses: Pulses) -> Paths:
        """Return a block's diffuse paths together with the volume echo in front of them."""
        if self._echo is None:
            return paths
        echo = self._echo.trace(pulses, paths)
        if self._polarization is not None:
            echo = self._polarization.received(echo, pulses)
        return Paths.concatenate([paths, echo])

    def through(self, paths: Paths, pulses: Pulses) -> Paths:
        """Return a block's paths with the propagation loss applied; none in clear air."""
        if self._weather.clear:
            return paths
        row, range_m = pulses.row_of(paths.pulse), paths.delay_s * (speed_of_light / 2)
        if self._weather.rain_map is None:
            left = two_way_attenuation(range_m, self.attenuation_db_per_km(pulses.true)[row])
        else:
            left = 10 ** (-2 * self._uneven_loss_db(self._weather.rain_map, pulses, row, range_m) / 10)
        if self._weather.wet_radome_m is not None:
            left = left * self._through_radome(pulses)[row]
        return dataclasses.replace(paths, gain=paths.gain * np.sqrt(left))

    def _uneven_loss_db(
        self, rain: RainMap, pulses: Pulses, row: Int[np.ndarray, " path"], range_m: Float[np.ndarray, " path"]
    ) -> Float[np.ndarray, " path"]:
        """Return the one-way loss in rain that varies along the boresight: the sum over range cells up to each path.

        Beyond the farthest sampled range it continues as in the last cell.
        """
        pose = pulses.true
        middle_m = (np.arange(self._steps) + 0.5) * self._step_m
        place_m = pose.position_m[:, None, :2] + middle_m[:, None] * pose.boresight[:, None, :2]
        drift_m = pulses.time_s[:, None] * np.array(self._weather.wind_mps[:2])
        rate_mm_per_h = rain.rate_mm_per_h(place_m - drift_m[:, None, :])
        k, alpha = rain_power_laws(self._weather.carrier_hz, self._mix(pose))
        db_per_km = self._weather.static_attenuation_db_per_km + k[:, None] * rate_mm_per_h ** alpha[:, None]
        loss_db = np.zeros((len(pulses), self._steps + 1))
        np.cumsum(db_per_km * (self._step_m / 1000), axis=1, out=loss_db[:, 1:])
        cell = np.minimum((range_m / self._step_m).astype(np.int64), self._steps - 1)
        beyond_km = (range_m - cell * self._step_m) / 1000
        return loss_db[row, cell] + db_per_km[row, cell] * beyond_km

    def _through_radome(self, pulses: Pulses) -> Float[np.ndarray, " pulse"]:
        """Return the share of an echo's power that passes the water film on the radome, both ways."""
        if self._weather.rain_map is None:
            rates = np.full(len(pulses), self._weather.rain_rate_mm_per_h)
        else:
            drift_m = pulses.time_s[:, None] * np.array(self._weather.wind_mps[:2])
            rates = self._weather.rain_map.rate_mm_per_h(pulses.true.position_m[:, :2] - drift_m)
        some, of = np.unique(rates, return_inverse=True)
        return 10 ** (-np.array([self._weather.wet_radome_loss_db(float(rate)) for rate in some]) / 10)[of]

    def attenuation_db_per_km(self, pose: Pose) -> Float[np.ndarray, " pulse"]:
        """Return the one-way specific attenuation along the boresight in uniform rain."""
        return self._weather.attenuation_db_per_km(self._mix(pose))

    def _mix(self, pose: Pose) -> Float[np.ndarray, " pulse"]:
        """Return the elevation and tilt term of P.838 for the boresight and the field.

        Rain attenuates a horizontal field more. With the field e, the boresight d and z up, the tilt of e from the
        horizontal axis h = z x d / |z x d| and the elevation of d make cos^2(el) cos(2 tilt) =
        2 (e . z x d)^2 - (1 - d_z^2), which is regular at nadir. V and H have opposite signs, so that a circular
        wave, with equal shares of both, has zero.
        """
        field = pose.R_world_antenna[:, :, 1 if self._antenna.polarization == "H" else 2]
        d = pose.boresight
        across = field[:, 1] * d[:, 0] - field[:, 0] * d[:, 1]
        mix: Float[np.ndarray, " pulse"] = 2 * across**2 - (1 - d[:, 2] ** 2)
        return mix * np.diff(np.abs(self._antenna.jones[0][::-1]) ** 2) if self._antenna.circular else mix
