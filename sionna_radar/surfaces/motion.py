"""Doppler and displacement of surfaces in the wind: plants by Billingsley's spectrum, water by JONSWAP waves."""

import math
from dataclasses import dataclass
from typing import Literal, no_type_check

import numpy as np
from jaxtyping import Float
from scipy.constants import g as gravity
from scipy.constants import mile, speed_of_light

from sionna_radar.foundation.compiled import compiled, turned

# No motion below this wind speed; Billingsley's fit ends at some 0.2 m/s, too.
CALM_MPS = 0.2
# Surface tension over density of clean water at 20 deg C, m^3/s^2.
TENSION_M3_PER_S2 = 7.28e-5
# Number of waves, shortest wave, and lowest frequency over that of the spectrum's peak.
WAVES, SHORTEST_WAVE_M, LOWEST_OVER_PEAK = 96, 0.1, 0.5
# JONSWAP spectrum: peak enhancement over a fully developed sea, and peak widths below and above the peak.
PEAK_ENHANCEMENT, PEAK_WIDTHS = 3.3, (0.07, 0.09)


@dataclass(frozen=True, kw_only=True)
class SurfaceMotion:
    """Kind of a surface's motion in the wind.

    fetch_m: length of water over which the wind has blown.
    """

    kind: Literal["plants", "water"]
    fetch_m: float = 1000.0


@dataclass(frozen=True, kw_only=True)
class Windblown:
    """Plants in the wind: a fraction of their scatterers is static, the others have a Doppler shift each.

    The shifts are constant and follow a two-sided exponential distribution. Source: Billingsley 2002, "Low-Angle Radar
    Land Clutter", as given by Richards 2014, "Fundamentals of Radar Signal Processing", section 2.3: measured from 170
    MHz to 9.2 GHz with a velocity spread independent of frequency, and extrapolated here to the carrier.
    """

    static_fraction: float
    mean_shift_hz: float

    @classmethod
    def of(cls, wind_mps: float, carrier_hz: float) -> "Windblown":
        """Return the motion for a wind and a carrier."""
        if wind_mps < CALM_MPS:
            return cls(static_fraction=1.0, mean_shift_hz=0.0)
        miles_per_hour = wind_mps * 3600 / mile
        still_over_moving = 10 ** (
            (63.2 - 15.5 * math.log10(miles_per_hour) - 12.1 * math.log10(1e-6 * carrier_hz)) / 10
        )
        mean_mps = 0.1048 * (math.log10(miles_per_hour) + 0.4147)
        return cls(
            static_fraction=still_over_moving / (1 + still_over_moving),
            mean_shift_hz=2 * mean_mps * carrier_hz / speed_of_light,
        )

    def field_correlation(self, lag_s: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Return the autocorrelation of the echo's field at time lags."""
        moving = 1 / (1 + (2 * np.pi * self.mean_shift_hz * lag_s) ** 2)
        return self.static_fraction + (1 - self.static_fraction) * moving

    def shift_hz(self, number: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """Return Doppler shifts of scatterers, positive toward the radar, from two uniform numbers in [0, 1) each."""
        side = 2 * number[:, 1] - 1
        shift_hz = -np.sign(side) * np.log(np.maximum(1 - np.abs(side), 2.0**-60)) * self.mean_shift_hz
        return np.where(number[:, 0] < self.static_fraction, 0.0, shift_hz)


@dataclass(frozen=True, kw_only=True)
class Waves:
    """Gravity waves on deep water, and the ripples on them.

    The long waves are drawn from the JONSWAP spectrum (Hasselmann and others 1973, "Measurements of wind-wave growth
    and swell decay") in directions spread by cos^2 about the wind; they move the surface along the orbits of linear
    theory.
    Bragg scattering is by ripples of half the radar wavelength along the line of sight, which run toward
    the radar or away from it at the phase speed of gravity and surface tension. A fraction cos^2(angle / 2) runs toward
    it, by the angle between the wind and the direction to the radar (Longuet-Higgins, Cartwright and
    Smith 1963; its exponent one is an assumption).

    wave_per_m: wave vectors, east and north, rad/m.
    rate_rad_per_s, amplitude_m, phase_rad: of each.
    downwind: unit vector, east and north.
    """

    wave_per_m: Float[np.ndarray, "wave 2"]
    rate_rad_per_s: Float[np.ndarray, " wave"]
    amplitude_m: Float[np.ndarray, " wave"]
    phase_rad: Float[np.ndarray, " wave"]
    downwind: Float[np.ndarray, " 2"]

    @classmethod
    def of(cls, wind_mps: Float[np.ndarray, " 2"], fetch_m: float, seed: int) -> "Waves":
        """Draw the waves of a wind (east, north; not calm) over a fetch."""
        speed = float(np.linalg.norm(wind_mps))
        peak, highest = peak_rate(speed, fetch_m), math.sqrt(2 * np.pi * gravity / SHORTEST_WAVE_M)
        lowest = LOWEST_OVER_PEAK * min(peak, highest / 2)
        random = np.random.default_rng([seed, round(fetch_m)])
        edge = np.geomspace(lowest, highest, WAVES + 1)
        rate = edge[:-1] + np.diff(edge) * random.random(WAVES)
        direction = np.arctan2(wind_mps[1], wind_mps[0]) + _spread(random.random(WAVES))
        wavenumber = rate**2 / gravity
        return cls(
            wave_per_m=wavenumber[:, None] * np.column_stack([np.cos(direction), np.sin(direction)]),
            rate_rad_per_s=rate,
            amplitude_m=np.sqrt(2 * jonswap(rate, speed, fetch_m) * np.diff(edge)),
            phase_rad=2 * np.pi * random.random(WAVES),
            downwind=wind_mps / speed,
        )

    def moved(
        self, place_m: Float[np.ndarray, "n 3"], time_s: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        """Return the displacement of the surface from rest, m, and its velocity, m/s, at places and times."""
        offset, velocity = np.zeros((2, len(place_m), 3))
        waves = (self.wave_per_m, self.rate_rad_per_s, self.amplitude_m, self.phase_rad)
        orbits(np.ascontiguousarray(place_m, dtype=np.float64), time_s, *waves, offset, velocity)
        return offset, velocity

    def ripple_hz(
        self, sight: Float[np.ndarray, "n 3"], number: Float[np.ndarray, " n"], wavelength_m: float
    ) -> Float[np.ndarray, " n"]:
        """Return the Doppler shift of the Bragg ripples, positive toward the radar.

        sight: unit vectors from the radar; number: uniform in [0, 1), of each scatterer.
        """
        across = np.linalg.norm(sight[:, :2], axis=1)
        wave_per_m = 4 * np.pi / wavelength_m * across
        shift_hz = np.sqrt(gravity * wave_per_m + TENSION_M3_PER_S2 * wave_per_m**3) / (2 * np.pi)
        toward = -(sight[:, :2] @ self.downwind) / np.maximum(across, 1e-9)
        return np.where(number < (1 + toward) / 2, shift_hz, -shift_hz)


def peak_rate(wind_mps: float, fetch_m: float) -> float:
    """Return the peak angular frequency of the wave spectrum, rad/s."""
    return 22 * (gravity**2 / (wind_mps * fetch_m)) ** (1 / 3)


def jonswap(rate_rad_per_s: Float[np.ndarray, " n"], wind_mps: float, fetch_m: float) -> Float[np.ndarray, " n"]:
    """Return the spectrum of the surface's height, m^2 s, at angular frequencies."""
    peak = peak_rate(wind_mps, fetch_m)
    level = 0.076 * (wind_mps**2 / (fetch_m * gravity)) ** 0.22
    width = np.where(rate_rad_per_s <= peak, *PEAK_WIDTHS)
    raised = PEAK_ENHANCEMENT ** np.exp(-(((rate_rad_per_s - peak) / (width * peak)) ** 2) / 2)
    return level * gravity**2 * rate_rad_per_s**-5.0 * np.exp(-1.25 * (peak / rate_rad_per_s) ** 4) * raised


def _spread(probability: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return quantiles in [0, 1) of angles within +-90 deg with the density (2 / pi) cos^2."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, 1001)
    return np.interp(probability, 0.5 + (angle + np.sin(2 * angle) / 2) / np.pi, angle)


@compiled
@no_type_check
def orbits(place, time_s, wave, rate, amplitude, phase, offset, velocity):
    """Add the orbits of deep-water waves: up by the cosine, against the wave's direction by the sine."""
    for k in range(len(rate)):
        wavenumber = np.sqrt(wave[k, 0] ** 2 + wave[k, 1] ** 2)
        east, north = wave[k, 0] / wavenumber, wave[k, 1] / wavenumber
        for i in range(len(place)):
            angle = wave[k, 0] * place[i, 0] + wave[k, 1] * place[i, 1] - rate[k] * time_s[i] + phase[k]
            cosine, sine = turned(angle / (2.0 * np.pi))
            cosine *= amplitude[k]
            sine *= amplitude[k]
            offset[i, 0] -= east * sine
            offset[i, 1] -= north * sine
            offset[i, 2] += cosine
            velocity[i, 0] += rate[k] * east * cosine
            velocity[i, 1] += rate[k] * north * cosine
            velocity[i, 2] += rate[k] * sine
