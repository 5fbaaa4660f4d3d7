"""The integral-equation model of a randomly rough surface; see `rough_surface` for the others and for all sources."""

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from jaxtyping import Complex, Float

from sionna_radar.surfaces.rough_surface import (
    Polarization,
    RoughSurface,
    check_polarization,
    check_series,
    fresnel_reflection,
    lit_cosine,
    poisson,
    spectra,
)

FresnelAngle = Literal["transition", "incidence", "nadir"]


@dataclass(frozen=True, kw_only=True)
class IntegralEquation:
    """Single-scattering integral-equation model (IEM) of Fung, Li and Chen (1992), co-polar backscatter.

    `fresnel_angle` is the angle of the Fresnel coefficient: that of "incidence" (slightly rough
    surfaces), "nadir" (very rough ones, far from grazing, where it grows without bound), or "transition",
    which goes from the first to the second as the roughness grows and back to the first toward grazing
    (Wu, Chen, Shi and Fung 2001).
    """

    surface: RoughSurface
    polarization: Polarization = "V"
    fresnel_angle: FresnelAngle = "transition"

    def __post_init__(self) -> None:
        check_polarization(self.polarization)
        check_series(self.surface)
        if self.fresnel_angle not in get_args(FresnelAngle):
            message = f"fresnel_angle = {self.fresnel_angle!r} is unknown; use 'transition', 'incidence' or 'nadir'"
            raise ValueError(message)

    def sigma0(self, incidence_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the radar cross-section per unit of surface area."""
        lit, cosine = lit_cosine(incidence_rad)
        surface = self.surface
        kirchhoff, complementary = self._fields(cosine)
        cross = 2.0 * np.real(kirchhoff * np.conj(complementary))
        depth = (surface.relative_height * cosine) ** 2
        total = np.zeros_like(cosine)
        # With a = (k s cos)^2, |2^n f e^-a + F|^2 a^n e^-2a / n! is multiplied out, so that each factor is a
        # Poisson weight and none overflows however rough the surface.
        for order, spectrum in spectra(surface, cosine):
            total += spectrum * (
                np.abs(kirchhoff) ** 2 * poisson(order, 4.0 * depth)
                + cross * np.exp(-depth) * poisson(order, 2.0 * depth)
                + np.abs(complementary) ** 2 * np.exp(-depth) * poisson(order, depth)
            )
        # Near grazing the H terms cancel; rounding must not leave a negative power.
        return np.where(lit, 0.5 * surface.wavenumber**2 * np.maximum(total, 0.0), 0.0)

    def _fields(self, cosine: Float[np.ndarray, " n"]) -> tuple[Complex[np.ndarray, " n"], Complex[np.ndarray, " n"]]:
        """Return the Kirchhoff and complementary field coefficients (Fung and others 1992)."""
        eps = self.surface.permittivity
        reflection = self._reflection(cosine)
        sine_squared = 1.0 - cosine**2
        tangent_squared = sine_squared / cosine**2
        common = sine_squared / cosine * (1.0 + reflection) ** 2
        if self.polarization == "V":
            bracket = (1.0 - 1.0 / eps) * (1.0 + tangent_squared / eps)
            return 2.0 * reflection / cosine, common * bracket
        return -2.0 * reflection / cosine, -common * (eps - 1.0) / cosine**2

    def _reflection(self, cosine: Float[np.ndarray, " n"]) -> Complex[np.ndarray, " n"]:
        eps = self.surface.permittivity
        at_incidence = fresnel_reflection(eps, cosine, self.polarization)
        at_nadir = fresnel_reflection(eps, np.ones_like(cosine), self.polarization)
        match self.fresnel_angle:
            case "incidence":
                return at_incidence
            case "nadir":
                return at_nadir
        return at_incidence + (at_nadir - at_incidence) * self._share_of_nadir(cosine)

    def _share_of_nadir(self, cosine: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return 1 - S / S0 of Wu and others (2001): 0 for a smooth surface or at grazing, 1 for a very rough one.

        S is the share of the complementary field in the backscatter when the coefficient is the nadir one, S0
        its limit for a vanishing roughness.
        """
        surface, eps = self.surface, self.surface.permittivity
        nadir = complex(fresnel_reflection(eps, np.ones(1), "V")[0])
        sine_squared = 1.0 - cosine**2
        refracted = np.sqrt(eps - sine_squared + 0j)
        # Both fields use the reflection at nadir, which cancels in the ratio.
        complementary = 8.0 * nadir * sine_squared * (cosine + refracted) / (cosine * refracted)
        kirchhoff = 2.0 / cosine
        cross = np.real(complementary) * kirchhoff
        depth = (surface.relative_height * cosine) ** 2
        # The sums of depth^n / n! spectrum over (1, 2^n, 4^n), each by exp(-depth), as Poisson weights.
        alone, once, twice = np.zeros((3, len(cosine)))
        for order, spectrum in spectra(surface, cosine):
            alone += spectrum * poisson(order, depth)
            once += spectrum * poisson(order, 2.0 * depth)
            twice += spectrum * poisson(order, 4.0 * depth)
        share = np.abs(complementary) ** 2 / 4.0 * alone
        limit = np.abs(complementary + 4.0 * kirchhoff) ** 2
        whole = share + cross * once + kirchhoff**2 * np.exp(depth) * twice
        # Where the spectrum has underflown there is no backscatter to share.
        return 1.0 - np.divide(limit * alone / 4.0, whole, out=np.ones_like(whole), where=whole > 0)

    def _exceeds_incidence_limit(self) -> bool:
        surface = self.surface
        return surface.relative_height * surface.relative_length > math.sqrt(abs(surface.permittivity))

    def validity(self) -> list[str]:
        """Return the violated conditions, in words; empty if the model is valid (limits: SMRT)."""
        surface = self.surface
        violated = []
        if surface.relative_height >= 3.0:
            violated.append(f"k s = {surface.relative_height:.3g} must be below 3: the surface is too rough")
        if self.fresnel_angle == "incidence" and self._exceeds_incidence_limit():
            product = surface.relative_height * surface.relative_length
            limit = math.sqrt(abs(surface.permittivity))
            violated.append(
                f"k s k L = {product:.3g} must be below |sqrt(eps)| = {limit:.3g} "
                "for a Fresnel coefficient at the angle of incidence"
            )
        return violated
