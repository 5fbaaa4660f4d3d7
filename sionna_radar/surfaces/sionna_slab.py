"""Sionna RT's ITU materials: their bands and backscatter.

Their diffuse model gives sigma0 = 4 S^2 R^2 cos^2 (1 - K), with S the scattering coefficient, R^2 the power that
the slab reflects at that angle and polarization, and K the cross-polar share. The coefficients are
Sionna's; the scattering matrix around them is ours (`RadarMaterial`), because Sionna's uses field components in
the world's spherical basis: for a linearly polarized antenna looking down at a scan angle it loses the co-polar
echo, 3 dB straight down and 4.5 to 24 dB off nadir.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.constants import epsilon_0, speed_of_light

from sionna_radar.raytracer.backend import load_sionna
from sionna_radar.surfaces.radar_material import Channel, RadarMaterial
from sionna_radar.surfaces.rough_surface import Polarization, fresnel_reflection


@dataclass(frozen=True, kw_only=True)
class SionnaSlab:
    """A slab of an ITU material in Sionna RT's parameters.

    scattering_coefficient: scattered over reflected field, S; xpd_coefficient: cross-polar share of its power, K.
    """

    itu_type: str
    thickness_m: float
    scattering_coefficient: float
    xpd_coefficient: float


@dataclass(frozen=True, kw_only=True)
class SlabBackscatter:
    """The co-polar backscatter of a slab (ITU-R P.2040 with Sionna's Lambertian pattern)."""

    slab: SionnaSlab
    permittivity: complex
    frequency_hz: float
    polarization: Polarization

    def sigma0(self, incidence_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the radar cross-section per unit of surface area."""
        return 4 * self.scattered_fraction(incidence_rad) * np.cos(incidence_rad) ** 2

    def scattered_fraction(self, incidence_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return scattered over incident power: Lambert's law with an albedo of (1 - K) S^2 R^2."""
        cosine = np.cos(incidence_rad)
        edge = fresnel_reflection(self.permittivity, np.maximum(cosine, 0.0), self.polarization)
        depth = 2 * np.pi * self.frequency_hz / speed_of_light * self.slab.thickness_m
        delay = np.exp(-2j * depth * np.sqrt(self.permittivity - np.sin(incidence_rad) ** 2 + 0j))
        reflection = edge * (1 - delay) / (1 - edge**2 * delay)
        copolar_share = self.slab.scattering_coefficient**2 * (1 - self.slab.xpd_coefficient)
        return copolar_share * np.abs(reflection) ** 2


def slab_material(slab: SionnaSlab, frequency_hz: float, channel: Channel) -> RadarMaterial:
    """Return the material of a slab; ValueError if Sionna does not define it or it does not scatter."""
    permittivity = _permittivity(slab.itu_type, frequency_hz)
    if slab.scattering_coefficient <= 0:
        raise ValueError(
            f"{slab.itu_type} has a scattering coefficient of 0 and returns no echo; map it to a material "
            f'with model = "sionna_itu", itu_type = "{slab.itu_type}" and a scattering_coefficient'
        )
    vertical, horizontal = (
        SlabBackscatter(slab=slab, permittivity=permittivity, frequency_hz=frequency_hz, polarization=p)
        for p in ("V", "H")
    )
    return RadarMaterial(
        vertical=vertical,
        horizontal=horizontal,
        cross_polar=slab.xpd_coefficient / (1 - slab.xpd_coefficient),
        channel=channel,
    )


def _permittivity(itu_type: str, frequency_hz: float) -> complex:
    load_sionna()
    from sionna.rt.radio_materials.itu import ITU_MATERIALS_PROPERTIES

    if itu_type not in ITU_MATERIALS_PROPERTIES:
        options = ", ".join(ITU_MATERIALS_PROPERTIES)
        raise ValueError(f"{itu_type!r} is not an ITU material known to Sionna RT; use one of {options}")
    bands = ITU_MATERIALS_PROPERTIES[itu_type]
    ghz = frequency_hz / 1e9
    for (lowest, highest), (a, b, c, d) in bands.items():
        if lowest <= ghz <= highest:
            return complex(a * ghz**b, -c * ghz**d / (2 * np.pi * frequency_hz * epsilon_0))
    defined = " and ".join(f"{lowest:g} to {highest:g} GHz" for lowest, highest in bands)
    raise ValueError(
        f"{itu_type} is defined from {defined}, not at the carrier's {ghz:g} GHz; map it to a material of the scenario"
    )
