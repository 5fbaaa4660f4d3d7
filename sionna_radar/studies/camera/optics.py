"""Optics of a camera: pixels of a pinhole, light on surfaces, the air between, and the exposure.

A Lambertian surface of albedo q and normal n has the luminance q / pi (E_sun cos(incidence) + pi L_sky (1 + n_z) / 2),
in shadow without the sun (uniform sky: Liu and Jordan 1963). Over a range r in air of extinction a it appears as
L exp(-a r) + L_sky (1 - exp(-a r)) (Koschmieder 1924): airlight tends to the luminance of the horizon, here that of
the uniform sky, which so stays as it is.

Sources. Sunlight at noon and a clear moonless night, 1e4 and 1e-4 foot-candles: Biberman 1971, "Natural levels of
illumination and irradiance" (abstract read). Diffuse fraction under the clearest skies, of the whole solar spectrum:
Erbs, Klein and Duffie 1982, Sol. Energy 28, 293-302. Visible albedos of plants, soil and water: Dickinson and others
1986 (BATS, below 0.7 um); of snow and what is built, of the whole solar spectrum: Oke 1987, "Boundary Layer Climates".
Exposure: ISO 12232. All but Biberman as restated in the literature; the works themselves were not at hand.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, UInt8

from sionna_radar.scenario.camera import CameraTable

LUX_PER_FOOT_CANDLE = 10.764
SUNLIGHT_LX, STARLIGHT_LX = 1e4 * LUX_PER_FOOT_CANDLE, 1e-4 * LUX_PER_FOOT_CANDLE
DIFFUSE_FRACTION = 0.165
# Of materials by name; all others have that of "ground", short grass.
VISIBLE_ALBEDO = {
    "ground": 0.10,
    "vegetation": 0.08,
    "dry_soil": 0.16,
    "wet_soil": 0.08,
    "water": 0.07,
    "snow": 0.90,
    "asphalt": 0.10,
    "concrete": 0.25,
    "building": 0.25,
}
# f-number, exposure that saturates at ISO 100 (78 / 100 lx s), its ratio to L t / N^2, and noise of the read-out.
F_NUMBER, SATURATION_LX_S, EXPOSURE_FACTOR, READ_NOISE_ELECTRONS = 2.8, 0.78, 0.65, 2.0
# Automatic exposure and gain put the brightest percent of the pixels below saturation by the headroom of ISO 12232.
BRIGHTEST, HEADROOM, LONGEST_EXPOSURE_S = 99.0, 2**0.5, 0.033
DISPLAY_GAMMA = 2.2


@dataclass(frozen=True, kw_only=True)
class Light:
    """Light of the sun, on a surface that faces it, and of a uniform sky."""

    toward_sun: Float[np.ndarray, " 3"]
    sun_lx: float
    sky_cd_m2: float


def light_of(table: CameraTable) -> Light:
    """Return the light of a clear day, or of a clear night without a moon."""
    elevation, azimuth = np.deg2rad([table.sun_elevation_deg, table.sun_azimuth_deg])
    horizontal = np.array([np.sin(azimuth), np.cos(azimuth), 0.0])
    toward = np.cos(elevation) * horizontal + np.array([0.0, 0.0, np.sin(elevation)])
    sky_lx = SUNLIGHT_LX * np.sin(elevation) * DIFFUSE_FRACTION / (1 - DIFFUSE_FRACTION)
    sun_lx, sky_lx = (0.0, STARLIGHT_LX) if table.night else (SUNLIGHT_LX, sky_lx)
    return Light(toward_sun=toward, sun_lx=sun_lx, sky_cd_m2=float(sky_lx / np.pi))


def pixel_directions(table: CameraTable) -> Float[np.ndarray, "row column 3"]:
    """Return unit vectors through the pixels of a pinhole: forward, right, down of the platform."""
    columns, rows = table.pixels
    view, depression = np.deg2rad([table.field_of_view_deg, table.depression_deg])
    right, down = (np.tan(view / 2) * (2 * np.arange(n) + 1 - n) / columns for n in (columns, rows))
    right, down = np.meshgrid(right, down)
    sin, cos = np.sin(depression), np.cos(depression)
    direction = np.stack([cos - down * sin, right, sin + down * cos], axis=-1)
    return direction / np.linalg.norm(direction, axis=-1, keepdims=True)


def surface_luminance(
    light: Light,
    albedo: Float[np.ndarray, " n"],
    normal: Float[np.ndarray, "n 3"],
    sunlit: Bool[np.ndarray, " n"],
) -> Float[np.ndarray, " n"]:
    """Return the luminance of Lambertian surfaces, cd/m2."""
    direct_lx = light.sun_lx * sunlit * np.maximum(normal @ light.toward_sun, 0.0)
    return albedo * (direct_lx / np.pi + light.sky_cd_m2 * (1 + normal[:, 2]) / 2)


def through_air(
    luminance_cd_m2: Float[np.ndarray, " n"],
    range_m: Float[np.ndarray, " n"],
    horizon_cd_m2: float,
    extinction_per_m: float,
) -> Float[np.ndarray, " n"]:
    """Return the luminance at a range: what the air leaves of it, and the airlight (Koschmieder 1924)."""
    transmission = np.exp(-extinction_per_m * range_m)
    return luminance_cd_m2 * transmission + horizon_cd_m2 * (1 - transmission)


def electrons_per_cd_m2(table: CameraTable, exposure_s: float) -> float:
    """Return the mean number of electrons in a pixel for each cd/m2."""
    return table.full_well * EXPOSURE_FACTOR * exposure_s / F_NUMBER**2 / SATURATION_LX_S


def expose(
    luminance_cd_m2: Float[np.ndarray, "row column"], table: CameraTable, generator: np.random.Generator
) -> tuple[UInt8[np.ndarray, "row column"], float]:
    """Return the grey levels of a screen, with shot and read noise, and the exposure time."""
    brightest, well, exposure_s = np.percentile(luminance_cd_m2, BRIGHTEST), table.full_well, LONGEST_EXPOSURE_S
    if table.exposure_ms is not None:
        exposure_s = 1e-3 * table.exposure_ms
    elif HEADROOM * brightest * electrons_per_cd_m2(table, exposure_s) > well:
        exposure_s = float(well / (HEADROOM * brightest * electrons_per_cd_m2(table, 1.0)))
    # Twice a full well is full with certainty, and keeps within the generator's range.
    electrons = np.minimum(electrons_per_cd_m2(table, exposure_s) * luminance_cd_m2, 2 * well)
    noise = READ_NOISE_ELECTRONS * generator.standard_normal(electrons.shape)
    counts = np.clip(generator.poisson(electrons) + noise, 0, well)
    white = well if table.exposure_ms is not None else HEADROOM * max(np.percentile(counts, BRIGHTEST), 1.0)
    return np.round(255 * np.minimum(counts / white, 1.0) ** (1 / DISPLAY_GAMMA)).astype(np.uint8), exposure_s
