"""Rain: attenuation (ITU-R P.838), reflectivity (Mie over Marshall-Palmer), and maps of rain cells and rain fields.

The two have different standing. P.838 is the recommended prediction of attenuation, the one to use.
For the backscatter at 77 GHz no recommendation was found, so it is computed from the drop size distribution.
A test checks the sum by the attenuation computed the same way: at
77 GHz it is 0.96 of P.838 at 1 mm/h, 1.26 at 10 mm/h and 1.3 at 25 to 50 mm/h (water at 10 deg C).

The rate is constant from the ground to above the aircraft; the slant of falling drops in the wind is neglected.
"""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from scipy.constants import speed_of_light

from sionna_radar.foundation.numerics import gauss_legendre
from sionna_radar.weather.drops import EchoSpeeds, ExponentialDrops, fall_speed_mps, marshall_palmer, weighted_speeds
from sionna_radar.weather.permittivity import water_permittivity
from sionna_radar.weather.scattering import mie_backscatter
from sionna_radar.weather.validity import require_between, require_not_negative

SOURCE = "ITU-R P.838-3"
LOWEST_FREQUENCY_HZ = 1e9
HIGHEST_FREQUENCY_HZ = 1000e9
NODES = 200
MEAN_DIAMETERS = 20.0


@dataclass(frozen=True)
class _Fit:
    """A sum of Gaussians in log10(f/GHz) over a straight line: P.838-3, eqs. 2 and 3."""

    terms: tuple[tuple[float, float, float], ...]  # (a_j, b_j, c_j)
    slope: float
    offset: float

    def at(self, frequency_ghz: float) -> float:
        x = math.log10(frequency_ghz)
        bumps = sum(a * math.exp(-(((x - b) / c) ** 2)) for a, b, c in self.terms)
        return bumps + self.slope * x + self.offset


# ITU-R P.838-3 (03/2005), Tables 1 to 4, 1 to 1000 GHz. The values agree in ITU-Rpy itu838.py, crc-covlib
# itur_p838.py and ssykiotis/RainAttenuation_MATLAB effplfactor.m; tests compare the fit with Table 5.
_LOG_K_HORIZONTAL = _Fit(  # Table 1
    (
        (-5.33980, -0.10008, 1.13098),
        (-0.35351, 1.26970, 0.45400),
        (-0.23789, 0.86036, 0.15354),
        (-0.94158, 0.64552, 0.16817),
    ),
    slope=-0.18961,
    offset=0.71147,
)
_LOG_K_VERTICAL = _Fit(  # Table 2
    (
        (-3.80595, 0.56934, 0.81061),
        (-3.44965, -0.22911, 0.51059),
        (-0.39902, 0.73042, 0.11899),
        (0.50167, 1.07319, 0.27195),
    ),
    slope=-0.16398,
    offset=0.63297,
)
_ALPHA_HORIZONTAL = _Fit(  # Table 3
    (
        (-0.14318, 1.82442, -0.55187),
        (0.29591, 0.77564, 0.19822),
        (0.32177, 0.63773, 0.13164),
        (-5.37610, -0.96230, 1.47828),
        (16.1721, -3.29980, 3.43990),
    ),
    slope=0.67849,
    offset=-1.95537,
)
_ALPHA_VERTICAL = _Fit(  # Table 4
    (
        (-0.07771, 2.33840, -0.76284),
        (0.56727, 0.95545, 0.54039),
        (-0.20238, 1.14520, 0.26809),
        (-48.2991, 0.791669, 0.116226),
        (48.5833, 0.791459, 0.116479),
    ),
    slope=-0.053739,
    offset=0.83433,
)


@dataclass(frozen=True, kw_only=True)
class RainPowerLaw:
    """Specific attenuation k R^alpha in dB/km, R the rain rate in mm/h."""

    k: float
    alpha: float

    def attenuation_db_per_km(self, rain_rate_mm_per_h: float) -> float:
        """Return the specific attenuation at a rain rate."""
        require_not_negative("rain_rate_mm_per_h", rain_rate_mm_per_h)
        return self.k * float(rain_rate_mm_per_h**self.alpha)


def rain_power_law(frequency_hz: float, *, elevation_rad: float, tilt_rad: float) -> RainPowerLaw:
    """Return k and alpha of ITU-R P.838-3 (eqs. 2 to 5), 1 to 1000 GHz.

    elevation_rad: of the path above (or below) the horizontal.
    tilt_rad: of the polarization from the horizontal: 0 horizontal, pi/2 vertical, pi/4 circular.
    """
    # Drops are oblate: polarization matters by the projection of their horizontal axis across the path.
    mix = math.cos(elevation_rad) ** 2 * math.cos(2.0 * tilt_rad)
    k, alpha = rain_power_laws(frequency_hz, np.array([mix]))
    return RainPowerLaw(k=float(k[0]), alpha=float(alpha[0]))


def rain_attenuations_db_per_km(
    frequency_hz: float, *, rain_rate_mm_per_h: float, mix: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return the one-way specific attenuation of rain (ITU-R P.838-3) for many paths.

    mix: cos^2(elevation) cos(2 tilt), the term of P.838-3 for path and polarization; from -1 (level
        path, vertical field) through 0 (straight down) to 1 (level path, horizontal field).
    """
    require_not_negative("rain_rate_mm_per_h", rain_rate_mm_per_h)
    k, alpha = rain_power_laws(frequency_hz, mix)
    return k * rain_rate_mm_per_h**alpha


def rain_power_laws(
    frequency_hz: float, mix: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return k and alpha of ITU-R P.838-3 for many paths; `mix` as in `rain_attenuations_db_per_km`."""
    require_between("frequency_hz", frequency_hz, LOWEST_FREQUENCY_HZ, HIGHEST_FREQUENCY_HZ, SOURCE)
    frequency_ghz = frequency_hz / 1e9
    k_h, k_v = 10.0 ** _LOG_K_HORIZONTAL.at(frequency_ghz), 10.0 ** _LOG_K_VERTICAL.at(frequency_ghz)
    ka_h = k_h * _ALPHA_HORIZONTAL.at(frequency_ghz)
    ka_v = k_v * _ALPHA_VERTICAL.at(frequency_ghz)
    k = (k_h + k_v + (k_h - k_v) * mix) / 2.0
    alpha = (ka_h + ka_v + (ka_h - ka_v) * mix) / (2.0 * k)
    return k, alpha


def rain_attenuation_db_per_km(
    frequency_hz: float, *, rain_rate_mm_per_h: float, elevation_rad: float, tilt_rad: float
) -> float:
    """Return the one-way specific attenuation of rain (ITU-R P.838-3); angles as in `rain_power_law`."""
    law = rain_power_law(frequency_hz, elevation_rad=elevation_rad, tilt_rad=tilt_rad)
    return law.attenuation_db_per_km(rain_rate_mm_per_h)


def rain_reflectivity_per_m(frequency_hz: float, *, rain_rate_mm_per_h: float, temperature_k: float) -> float:
    """Return the radar cross-section of a cubic metre of rain (m2/m3), eta.

    Mie backscatter of water spheres, summed over Marshall-Palmer drops, for co-polar reception:
    spheres have no cross-polar echo. At 94 GHz the echo from 250 m agrees with what radars
    measure in 3 to 10 mm/h, 19 dBZ with a spread of 1.5 dB (Hogan et al. 2003, J. Atmos. Oceanic Technol. 20,
    572); single showers differ by more. Real drops are flattened, which is neglected here.
    """
    require_not_negative("rain_rate_mm_per_h", rain_rate_mm_per_h)
    if rain_rate_mm_per_h == 0:
        return 0.0
    return drop_reflectivity_per_m(frequency_hz, drops=marshall_palmer(rain_rate_mm_per_h), temperature_k=temperature_k)


def drop_reflectivity_per_m(frequency_hz: float, *, drops: ExponentialDrops, temperature_k: float) -> float:
    """Return eta (m2/m3) of a custom drop size distribution: the integral of N(D) sigma_back(D) over D."""
    return drop_echo(frequency_hz, drops=drops, temperature_k=temperature_k)[0]


def echo_speeds(frequency_hz: float, *, drops: ExponentialDrops, temperature_k: float) -> EchoSpeeds:
    """Return the fall speeds of drops, weighted by the echo of each size."""
    return drop_echo(frequency_hz, drops=drops, temperature_k=temperature_k)[1]


@lru_cache(maxsize=256)
def drop_echo(frequency_hz: float, *, drops: ExponentialDrops, temperature_k: float) -> tuple[float, EchoSpeeds]:
    """Return the reflectivity (m2/m3) of drops, and their echo-weighted fall speeds, summed in some 50 ms."""
    # From 0 to 20 mean diameters: only e^-20 of all drops are larger. The nodes resolve the
    # ripples of the efficiencies; a test takes more than twice as many.
    diameter_m, weight_m = _diameters(drops)
    area_per_m3 = weight_m * drops.density_per_m4(diameter_m) * np.pi / 4.0 * diameter_m**2
    refractive_index = water_permittivity(frequency_hz, temperature_k) ** 0.5
    weight = area_per_m3 * mie_backscatter(np.pi * diameter_m * frequency_hz / speed_of_light, refractive_index)
    return float(np.sum(weight)), weighted_speeds(weight, fall_speed_mps(diameter_m))


def _diameters(drops: ExponentialDrops) -> tuple[Float[np.ndarray, " node"], Float[np.ndarray, " node"]]:
    """Return the nodes of integrals over the diameter, increasing, and their weights."""
    nodes, weights = gauss_legendre(NODES)
    half_span_m = MEAN_DIAMETERS / drops.slope_per_m / 2.0
    return half_span_m * (1.0 + nodes), half_span_m * weights


# Rain below this has no echo; P.838 and Marshall-Palmer are valid far above it.
MIN_MM_PER_H = 0.01
MAX_MM_PER_H = 300.0
NEPERS_PER_DB = math.log(10.0) / 10.0


@runtime_checkable
class RainMap(Protocol):
    """Rain rates by position."""

    def rate_mm_per_h(self, position_m: Float[np.ndarray, "*shape 2"]) -> Float[np.ndarray, "*shape"]:
        """Return the rain rate at positions east and north."""


@dataclass(frozen=True, kw_only=True)
class RainCell:
    """A shower whose rate falls off exponentially from its centre: R = peak exp(-d / radius).

    The profile of EXCELL (Capsoni et al. 1987, Radio Sci. 22, 387-404: from memory), and the average of cells
    measured by two radars (von Hardenberg et al. 2003, GRL 30, 2280: abstract read). A Gaussian core (HYCELL) of the
    same peak and area has less rain in the middle than these measurements.
    """

    centre_m: tuple[float, float]
    radius_m: float
    peak_mm_per_h: float

    def rate_mm_per_h(self, position_m: Float[np.ndarray, "*shape 2"]) -> Float[np.ndarray, "*shape"]:
        """Return the rain rate at positions east and north."""
        offset_m = position_m - np.array(self.centre_m)
        return self.peak_mm_per_h * np.exp(-np.hypot(offset_m[..., 0], offset_m[..., 1]) / self.radius_m)


@dataclass(frozen=True, kw_only=True)
class RainField:
    """A log-normal rain rate with a mean, and a correlation of its logarithm exp(-d / correlation_m).

    A model choice: rain rates are near log-normal, and their correlation near exponential over some kilometres;
    variations within a few hundred metres are seldom measured. The field repeats after `PERIOD`
    correlation lengths, and is interpolated linearly between nodes, which loses 4 % of its variance.
    """

    mean_mm_per_h: float
    correlation_m: float
    spread_db: float
    seed: int

    NODES_PER_LENGTH = 16
    PERIOD = 32

    @cached_property
    def _normal(self) -> Float[np.ndarray, "node node"]:
        """A periodic Gaussian field of unit variance: white noise filtered by the root of its spectrum."""
        count = self.NODES_PER_LENGTH * self.PERIOD
        steps = np.minimum(np.arange(count), count - np.arange(count)) / self.NODES_PER_LENGTH
        covariance = np.exp(-np.hypot(steps[:, None], steps[None, :]))
        spectrum = np.maximum(np.fft.rfft2(covariance).real, 0.0)
        white = np.random.Generator(np.random.PCG64(self.seed)).standard_normal((count, count))
        return np.fft.irfft2(np.fft.rfft2(white) * np.sqrt(spectrum), s=(count, count))

    def rate_mm_per_h(self, position_m: Float[np.ndarray, "*shape 2"]) -> Float[np.ndarray, "*shape"]:
        """Return the rain rate at positions east and north."""
        grid_position = position_m * (self.NODES_PER_LENGTH / self.correlation_m)
        node = np.floor(grid_position).astype(np.int64)
        fraction = grid_position - node
        count = self.NODES_PER_LENGTH * self.PERIOD
        (i, j), (u, v) = np.moveaxis(node % count, -1, 0), np.moveaxis(fraction, -1, 0)
        next_i, next_j = (i + 1) % count, (j + 1) % count
        field = self._normal
        normal = (1 - u) * ((1 - v) * field[i, j] + v * field[i, next_j]) + u * (
            (1 - v) * field[next_i, j] + v * field[next_i, next_j]
        )
        spread = NEPERS_PER_DB * self.spread_db
        return self.mean_mm_per_h * np.exp(spread * normal - spread**2 / 2)


@dataclass(frozen=True, kw_only=True)
class CombinedRain:
    """A shower within widespread rain: the rates add."""

    maps: tuple[RainMap, ...]
    everywhere_mm_per_h: float = 0.0

    def rate_mm_per_h(self, position_m: Float[np.ndarray, "*shape 2"]) -> Float[np.ndarray, "*shape"]:
        """Return the rain rate at positions east and north, limited to the range of the models."""
        rate = np.full(position_m.shape[:-1], self.everywhere_mm_per_h)
        for rain in self.maps:
            rate = rate + rain.rate_mm_per_h(position_m)
        return np.minimum(rate, MAX_MM_PER_H)
