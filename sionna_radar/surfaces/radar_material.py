"""Polarimetric backscatter of a surface: VV, HH and cross-polar sigma0, circular waves, and a mirror reflection.

Scattering matrix of a small piece of the surface, in its local axes (h across the plane of incidence, v in it)
and the same for transmission and reception:

    | a_h  0  |       | j s1   s2   |
    |  0  a_v |  + x  | s2   -j s1  |      s1, s2 = +-1, drawn for each position

The second part carries the cross-polar power x^2. It is symmetric, so VH equals HV (reciprocity), and rotating
the axes only changes its phase, on average over the signs: at nadir, where the axes are arbitrary, nothing depends
on them. It also adds x^2 to the co-polar channels, which a_h and a_v allow for. So the two co-polar channels
correlate by (a_h a_v - x^2) / sqrt(s_h s_v), that is by 1 - 2 x^2 / s where V and H are equal, as in every scatterer
with rotational symmetry about the line of sight (Nghiem and others 1992, "Symmetry properties in
polarimetric remote sensing", Radio Science 27, 693-711: s_hv = (s - Re<hh vv*>) / 2).

Where a correlation rho is given instead, the diagonal has d in place of x, from rho sqrt(s_h s_v) = a_h a_v - d^2 with
a^2 = s - d^2; toward nadir, where V and H are the same, d tends to x again.

A circular wave (v + j h) / sqrt 2 returns in the same sense (v - h + 2 j x') / 2 and in the opposite one
(v + h) / 2, with v and h the co-polar and x' the cross-polar amplitude:

    same sense       (a_v - a_h)^2 / 4 + d^2 + x^2  =  (s_h + s_v - 2 rho sqrt(s_h s_v)) / 4 + s_hv
    opposite sense   (a_v + a_h)^2 / 4              =  (s_h + s_v + 2 rho sqrt(s_h s_v)) / 4

A linear wave that makes an angle p with v, sent and received, returns with

    (a_v cos^2 p + a_h sin^2 p)^2 + d^2 cos^2 2p + x^2 sin^2 2p,

and one sent at p and received across it with ((a_v - a_h)^2 / 4 + d^2) sin^2 2p + x^2 cos^2 2p.

The phase between V and H of a lossy rough surface is neglected: over soil at 77 GHz it is 1 to 10 deg.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from scipy.constants import speed_of_light

from sionna_radar.foundation.decibels import from_db
from sionna_radar.surfaces.backscatter import Backscatter, HasScatteredFraction
from sionna_radar.surfaces.rough_surface import coherent_power_factor, fresnel_reflection

Channel = Literal["VV", "HH", "VH", "HV", "same", "opposite"]
# Bare ground, rough against the wavelength: s_hv / s_vv = 0.23 sqrt(G) by Oh, Sarabandi and Ulaby 1992 (IEEE TGRS 30,
# 370-381), which Ulaby and others 1998 ("95-GHz scattering by terrain at near-grazing incidence", IEEE TAP 46, 3-13)
# compare with measurements at 95 GHz; G, the reflection at normal incidence, is 0.1 to 0.3 for soils, so -11 to -9 dB.
# Grass and other vegetation have more.
TYPICAL_CROSS_POLAR_DB = -10.0
# Incidence angle from which a given co-polar correlation applies.
CORRELATED_FROM_RAD = float(np.deg2rad(20.0))


@dataclass(frozen=True, kw_only=True)
class Mirror:
    """The coherent reflection of a plane, rough or smooth, at normal incidence."""

    permittivity: complex
    rms_height_m: float
    frequency_hz: float

    @property
    def amplitude(self) -> complex:
        """Reflected over incident field, both along the same axis: Fresnel coefficient times the coherent factor."""
        factor = 1.0
        if self.rms_height_m > 0:
            factor = float(coherent_power_factor(self.rms_height_m, self.frequency_hz, np.zeros(1))[0])
        smooth = complex(fresnel_reflection(self.permittivity, np.ones(1), "H")[0])
        return smooth * factor**0.5


@dataclass(frozen=True, kw_only=True)
class ScatteringAmplitudes:
    """The amplitudes of the matrix in the module docstring: a_v, a_h, d (on the diagonal) and x (off it)."""

    vertical: Float[np.ndarray, " n"]
    horizontal: Float[np.ndarray, " n"]
    opposed: Float[np.ndarray, " n"]
    exchanged: Float[np.ndarray, " n"]


@dataclass(frozen=True, kw_only=True)
class RadarMaterial:
    """A surface's backscatter in every channel; itself a `Backscatter`, for the channel in use.

    vertical, horizontal: co-polar sigma0 for a field in the plane of incidence and across it.
    cross_polar: cross-polar sigma0 over the weaker of the two.
    copolar_correlation: of VV and HH off nadir, 0 to 1; None for that of a rotationally symmetric scatterer.
    channel: polarizations of reception and transmission (VH: receives V, transmits H; equal to HV), or the received
        sense of a circular wave.
    mirror: None for a surface without a specular return.
    """

    vertical: Backscatter
    horizontal: Backscatter
    cross_polar: float = 0.0
    copolar_correlation: float | None = None
    channel: Channel = "VV"
    mirror: Mirror | None = None

    def sigma0(self, incidence_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the cross-section per unit of surface area in the channel."""
        if self.channel in ("VH", "HV"):
            return self.cross_sigma0(incidence_rad)
        if self.channel in ("same", "opposite"):
            return self._circular_sigma0(incidence_rad)
        return self.co_polar.sigma0(incidence_rad)

    def linear_sigma0(
        self,
        incidence_rad: Float[np.ndarray, " n"],
        polarization_rad: Float[np.ndarray, " n"],
        cross: Bool[np.ndarray, " n"],
    ) -> Float[np.ndarray, " n"]:
        """Return the cross-section at angles between polarization and plane of incidence: 0 is VV, pi/2 HH.

        cross: which are received across the wave that was sent.
        """
        amplitudes, twice = self.amplitudes(incidence_rad), 2 * polarization_rad
        along = (
            amplitudes.vertical * np.cos(polarization_rad) ** 2 + amplitudes.horizontal * np.sin(polarization_rad) ** 2
        )
        co = along**2 + (amplitudes.opposed * np.cos(twice)) ** 2 + (amplitudes.exchanged * np.sin(twice)) ** 2
        across = (amplitudes.vertical - amplitudes.horizontal) ** 2 / 4 + amplitudes.opposed**2
        return np.where(cross, across * np.sin(twice) ** 2 + (amplitudes.exchanged * np.cos(twice)) ** 2, co)

    def _circular_sigma0(self, incidence_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        amplitudes = self.amplitudes(incidence_rad)
        if self.channel == "opposite":
            return (amplitudes.vertical + amplitudes.horizontal) ** 2 / 4
        return (amplitudes.vertical - amplitudes.horizontal) ** 2 / 4 + amplitudes.opposed**2 + amplitudes.exchanged**2

    def amplitudes(
        self, incidence_rad: Float[np.ndarray, " n"], spread: float | Float[np.ndarray, " n"] = 1.0
    ) -> ScatteringAmplitudes:
        """Return the amplitudes of the scattering matrix, whose squares are sigma0 over `spread`."""
        cross = self.cross_sigma0(incidence_rad) / spread
        vertical, horizontal = (m.sigma0(incidence_rad) / spread for m in (self.vertical, self.horizontal))
        opposed = self._opposed(vertical, horizontal, cross, incidence_rad)
        return ScatteringAmplitudes(
            vertical=np.sqrt(np.maximum(vertical - opposed, 0.0)),
            horizontal=np.sqrt(np.maximum(horizontal - opposed, 0.0)),
            opposed=np.sqrt(opposed),
            exchanged=np.sqrt(cross),
        )

    def _opposed(
        self,
        vertical: Float[np.ndarray, " n"],
        horizontal: Float[np.ndarray, " n"],
        cross: Float[np.ndarray, " n"],
        incidence_rad: Float[np.ndarray, " n"],
    ) -> Float[np.ndarray, " n"]:
        """Return d^2 = v h (1 - rho^2) / (v + h + 2 rho sqrt(v h)), from the two equations of the module docstring."""
        rho = self.copolar_correlation
        if rho is None:
            return cross
        denominator = np.maximum(vertical + horizontal + 2 * rho * np.sqrt(vertical * horizontal), np.finfo(float).tiny)
        correlated = vertical * horizontal * (1 - rho**2) / denominator
        weight = np.minimum((np.sin(incidence_rad) / np.sin(CORRELATED_FROM_RAD)) ** 2, 1.0)
        return cross + weight * (correlated - cross)

    def cross_sigma0(self, incidence_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the cross-polar cross-section per unit of surface area."""
        vertical, horizontal = (m.sigma0(incidence_rad) for m in (self.vertical, self.horizontal))
        return self.cross_polar * np.minimum(vertical, horizontal)

    @property
    def co_polar(self) -> Backscatter:
        """The stronger echo: co-polar, or for a circular wave that in the opposite sense."""
        if self.channel in ("same", "opposite"):
            return replace(self, channel="opposite")
        return self.vertical if self.channel in ("VV", "HV") else self.horizontal

    def scattered_fraction(self, incidence_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return scattered over incident power, mirror included, the larger of V and H transmitted.

        A model may provide its total scattering by `scattered_fraction`. Any other is assumed to re-radiate its
        field equally into every direction of the hemisphere, projected across the direction, as the ray tracer's
        material does: sigma0 / (4 pi cos) times the effective solid angle 4 pi / 3 after projection. The cross-polar
        field is added.
        """
        cosine = np.maximum(np.cos(incidence_rad), 1e-9)
        fractions = []
        for model in (self.vertical, self.horizontal):
            if isinstance(model, HasScatteredFraction):
                fractions.append(model.scattered_fraction(incidence_rad) * (1 + self.cross_polar))
            else:
                fractions.append((model.sigma0(incidence_rad) + self.cross_sigma0(incidence_rad)) / (3 * cosine))
        fraction: Float[np.ndarray, " n"] = np.maximum(*fractions)
        if self.mirror is not None:
            fraction = fraction + self._reflectance(self.mirror, incidence_rad)
        return fraction

    @staticmethod
    def _reflectance(mirror: Mirror, incidence_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        cosine = np.cos(incidence_rad)
        strongest = np.maximum(*(np.abs(fresnel_reflection(mirror.permittivity, cosine, p)) ** 2 for p in ("V", "H")))
        phase = 4 * np.pi * mirror.frequency_hz / speed_of_light * mirror.rms_height_m * cosine
        return strongest * np.exp(-(phase**2))


def as_radar_material(backscatter: Backscatter, channel: Channel = "VV") -> RadarMaterial:
    """Return a backscatter model as a material with equal V and H, unless it is already a material."""
    if isinstance(backscatter, RadarMaterial):
        return backscatter
    cross_polar = typical_cross_polar(channel)
    return RadarMaterial(vertical=backscatter, horizontal=backscatter, cross_polar=cross_polar, channel=channel)


def typical_cross_polar(channel: Channel) -> float:
    """Return the default cross-polar ratio: zero for a linear wave, a typical value for a circular one."""
    return from_db(TYPICAL_CROSS_POLAR_DB) if channel in ("same", "opposite") else 0.0
