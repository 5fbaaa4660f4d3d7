"""Backscatter of a randomly rough dielectric surface, from its permittivity, height and correlation length.

Four models of the same surface, each with its conditions (`validity()` lists those violated):

| model | surface | polarization |
|---|---|---|
| `GeometricalOptics` | very rough, gently sloping (stationary phase) | V = H |
| `PhysicalOpticsModel` | gently sloping, any height (Kirchhoff) | V and H differ by their Fresnel coefficient |
| `SmallPerturbationModel` | slightly rough, first order | V > H off nadir |
| `IntegralEquationModel` | in between; tends to the others (single scattering) | V and H |

Angles are incidence angles in radians from the surface normal. At and beyond grazing all return zero. None
contains the coherent (mirror) return, whose fraction of the Fresnel reflection is `coherent_power_factor`; these models
describe the incoherent part. None contains self-shadowing of the surface.
Permittivities follow exp(+j w t): eps' - j eps''.

Sources read while this was written:

* IEM: Fung, Li and Chen, IEEE TGRS 30 (1992) 356-369, eqs. 44, 45, 82, 91 and 95, through SMRT's
  `smrt/interface/iem_fung92.py`, whose regression values the tests repeat. The transition of its
  Fresnel coefficient: Wu, Chen, Shi and Fung, IEEE TGRS 39 (2001) 2040-2050, abstract; equations through CReSIS's
  `iemb.m` (from Fung and Chen, "Microwave Scattering and Emission Models for Users", 2010).
* Small perturbation: Ulaby, Moore and Fung, "Microwave Remote Sensing" II pp. 949-966, and Ruck, "Radar Cross
  Section Handbook" 2 pp. 703-718, through a public transcription (`smallPerturbation.m`).
* Geometrical optics: Ulaby, Moore and Fung II pp. 925-936, through `physicalOpticsLargeUlaby.m` and SMRT's
  `geometrical_optics_backscatter.py`.
* The sources of the limits in `validity()` are given there.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Complex, Float
from scipy.constants import speed_of_light

Polarization = Literal["V", "H"]
Correlation = Literal["gaussian", "exponential"]

# The series in the roughness needs about (2 k s)^2 terms; far above this height geometrical optics is valid.
MAX_RELATIVE_HEIGHT = 20.0
# Below this cosine (0.006 deg from grazing) quotients of vanishing terms are set to their limit, zero.
_GRAZING_COSINE = 1e-4


@dataclass(frozen=True, kw_only=True)
class RoughSurface:
    """A statistically uniform, isotropic rough boundary between air and a medium, at one frequency.

    `correlation` is the height autocorrelation: "gaussian" exp(-(r/L)^2) or "exponential" exp(-r/L).
    """

    permittivity: complex | float
    rms_height_m: float
    correlation_length_m: float
    frequency_hz: float
    correlation: Correlation = "gaussian"

    @property
    def wavenumber(self) -> float:
        """k, in radians per metre."""
        return _wavenumber(self.frequency_hz)

    @property
    def relative_height(self) -> float:
        """The product k s of wavenumber and rms height."""
        return self.wavenumber * self.rms_height_m

    @property
    def relative_length(self) -> float:
        """The product k L of wavenumber and correlation length."""
        return self.wavenumber * self.correlation_length_m

    @property
    def rms_slope(self) -> float | None:
        """Rms slope, sqrt(2) s / L; None for an exponential correlation, whose slope has no finite mean."""
        if self.correlation == "exponential":
            return None
        return math.sqrt(2.0) * self.rms_height_m / self.correlation_length_m

    def spectrum(self, order: int, spatial_frequency: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the roughness spectrum of the order-th power of the correlation (m^2).

        It is the two-dimensional Fourier transform over 2 pi (Fung and others 1992; SMRT's `W_n`).
        """
        length = self.correlation_length_m
        scaled = spatial_frequency * length
        density: Float[np.ndarray, " n"]
        if self.correlation == "gaussian":
            density = length**2 / (2.0 * order) * np.exp(-(scaled**2) / (4.0 * order))
        else:
            density = (length / order) ** 2 * (1.0 + (scaled / order) ** 2) ** -1.5
        return density


def fresnel_reflection(
    permittivity: complex | float, cosine: Float[np.ndarray, " n"], polarization: Polarization
) -> Complex[np.ndarray, " n"]:
    """Return the amplitude reflection coefficient of a smooth boundary, by the cosine of incidence.

    Signs as in Fung and others (1992): at nadir V is (sqrt(eps) - 1)/(sqrt(eps) + 1), H its negative.
    """
    refracted = np.sqrt(permittivity - (1.0 - cosine**2) + 0j)
    incident = permittivity * cosine if polarization == "V" else cosine
    return (incident - refracted) / (incident + refracted)


def coherent_power_factor(
    rms_height_m: float, frequency_hz: float, incidence_rad: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return exp(-(2 k s cos)^2): the coherent fraction of the power reflected by a rough surface.

    For Gaussian heights (Tsang 2001 I, eq. 2.1.94, as used by SMRT).
    """
    phase = 2.0 * _wavenumber(frequency_hz) * rms_height_m * np.cos(incidence_rad)
    return np.exp(-(phase**2))


@dataclass(frozen=True, kw_only=True)
class GeometricalOptics:
    """Kirchhoff backscatter in the stationary-phase limit: specular slopes of the surface.

    sigma0 = |R(0)|^2 exp(-tan^2/(2 m^2)) / (2 m^2 cos^4), m the rms slope. Needs a Gaussian correlation.
    """

    surface: RoughSurface
    polarization: Polarization = "V"

    def sigma0(self, incidence_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the radar cross-section per unit of surface area."""
        slope = self.surface.rms_slope
        assert slope is not None, "an exponential correlation has none"
        lit, cosine = lit_cosine(incidence_rad)
        mirror = abs(fresnel_reflection(self.surface.permittivity, np.ones(1), "V")[0]) ** 2
        tangent_squared = 1.0 / cosine**2 - 1.0
        value = mirror * np.exp(-tangent_squared / (2.0 * slope**2)) / (2.0 * slope**2 * cosine**4)
        return np.where(lit, value, 0.0)

    def validity(self, incidence_rad: float = 0.0) -> list[str]:
        """Return the violated conditions, in words; empty if the model is valid."""
        depth = 2.0 * self.surface.relative_height * math.cos(incidence_rad)
        violated = _gentle_surface_violations(self.surface)
        if depth**2 <= 10.0:  # assumption (a) of physicalOpticsLargeUlaby.m (Ulaby, Moore and Fung II)
            violated.append(f"(2 k s cos)^2 = {depth**2:.3g} must exceed 10: the surface is not rough enough")
        return violated


@dataclass(frozen=True, kw_only=True)
class SmallPerturbationModel:
    """First-order small-perturbation (Bragg) backscatter of a slightly rough surface."""

    surface: RoughSurface
    polarization: Polarization = "V"

    def sigma0(self, incidence_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the radar cross-section per unit of surface area."""
        lit, cosine = lit_cosine(incidence_rad)
        surface = self.surface
        k = surface.wavenumber
        coupling = self._coupling(cosine)
        bragg = surface.spectrum(1, 2.0 * k * np.sqrt(1.0 - cosine**2))
        value = 8.0 * k**4 * surface.rms_height_m**2 * cosine**4 * np.abs(coupling) ** 2 * bragg
        return np.where(lit, value, 0.0)

    def _coupling(self, cosine: Float[np.ndarray, " n"]) -> Complex[np.ndarray, " n"]:
        """Return the coefficient alpha of Ulaby, Moore and Fung for backscatter."""
        eps = self.surface.permittivity
        if self.polarization == "H":
            return fresnel_reflection(eps, cosine, "H")
        sine_squared = 1.0 - cosine**2
        refracted = np.sqrt(eps - sine_squared + 0j)
        numerator = (eps - 1.0) * (eps * (1.0 + sine_squared) - sine_squared)
        return numerator / (eps * cosine + refracted) ** 2

    def validity(self) -> list[str]:
        """Return the violated conditions, in words; empty if the model is valid."""
        surface = self.surface
        violated = []
        if surface.relative_height >= 0.3:  # limit stated for SPM by github Morteza-Khazaei/mwrtms, SPMModel
            violated.append(f"k s = {surface.relative_height:.3g} must be below 0.3: the surface is too rough")
        slope = surface.rms_slope
        if slope is not None and slope >= 1.0:  # Ruck pp. 704, assumption (b): slopes below one
            violated.append(f"rms slope = {slope:.3g} must be below 1: the surface is too steep")
        return violated


@dataclass(frozen=True, kw_only=True)
class PhysicalOpticsModel:
    """Kirchhoff backscatter of a gently sloping surface of any height: only the first term of the IEM.

    The Fresnel coefficient is taken at the angle of incidence, so V shows a Brewster minimum that a truly
    rough surface does not have.
    """

    surface: RoughSurface
    polarization: Polarization = "V"

    def __post_init__(self) -> None:
        check_series(self.surface)

    def sigma0(self, incidence_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the radar cross-section per unit of surface area."""
        lit, cosine = lit_cosine(incidence_rad)
        surface = self.surface
        reflection = fresnel_reflection(surface.permittivity, cosine, self.polarization)
        field = 2.0 * reflection / cosine  # Fung and others 1992, eqs. 44 and 45 (their sign is immaterial)
        total = np.zeros_like(cosine)
        for order, spectrum in spectra(surface, cosine):
            total += spectrum * poisson(order, 4.0 * (surface.relative_height * cosine) ** 2)
        return np.where(lit, 0.5 * surface.wavenumber**2 * np.abs(field) ** 2 * total, 0.0)

    def validity(self) -> list[str]:
        """Return the violated conditions, in words; empty if the model is valid."""
        return _gentle_surface_violations(self.surface)


def _wavenumber(frequency_hz: float) -> float:
    return 2.0 * math.pi * frequency_hz / float(speed_of_light)


def lit_cosine(
    incidence_rad: Float[np.ndarray, " n"],
) -> tuple[np.ndarray, Float[np.ndarray, " n"]]:
    """Return a mask of the angles short of grazing, and the cosines bounded away from zero."""
    cosine = np.cos(np.abs(incidence_rad))
    return cosine > _GRAZING_COSINE, np.maximum(cosine, _GRAZING_COSINE)


def spectra(surface: RoughSurface, cosine: Float[np.ndarray, " n"]) -> Iterator[tuple[int, Float[np.ndarray, " n"]]]:
    """Yield the orders of the roughness series with their spectra at the Bragg frequency 2 k sin."""
    bragg = 2.0 * surface.wavenumber * np.sqrt(1.0 - cosine**2)
    mean = 4.0 * surface.relative_height**2
    # A Poisson weight is below 1e-15 ten standard deviations above its mean; fifteen more terms cover small means.
    for order in range(1, math.ceil(mean + 10.0 * math.sqrt(mean)) + 16):
        yield order, surface.spectrum(order, bragg)


def poisson(order: int, mean: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return exp(-mean) mean^order / order!, without overflow."""
    return np.exp(order * np.log(mean) - mean - math.lgamma(order + 1.0))


def check_series(surface: RoughSurface) -> None:
    """Raise ValueError for a surface that is too rough for a series in its roughness."""
    if surface.relative_height > MAX_RELATIVE_HEIGHT:
        raise ValueError(
            f"rms_height_m = {surface.rms_height_m:g} gives k s = {surface.relative_height:.3g}, "
            f"above {MAX_RELATIVE_HEIGHT:g}; use GeometricalOptics"
        )


def _gentle_surface_violations(surface: RoughSurface) -> list[str]:
    """Return the violated Kirchhoff conditions: assumption (f) of physicalOpticsLargeUlaby.m (Ulaby II)."""
    violated = []
    if surface.relative_length <= 6.0:
        violated.append(f"k L = {surface.relative_length:.3g} must exceed 6: the bumps are too short")
    wavelength = 2.0 * math.pi / surface.wavenumber
    needed = 2.76 * surface.rms_height_m * wavelength
    if surface.correlation_length_m**2 <= needed:
        violated.append(
            f"L^2 = {surface.correlation_length_m**2:.3g} m^2 must exceed 2.76 s lambda = {needed:.3g} m^2: "
            "the bumps are too sharp"
        )
    return violated


FresnelAngle = Literal["transition", "incidence", "nadir"]


@dataclass(frozen=True, kw_only=True)
class IntegralEquationModel:
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
        check_series(self.surface)

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
        return at_incidence + (at_nadir - at_incidence) * self._nadir_weight(cosine)

    def _nadir_weight(self, cosine: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
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
        sum_1, sum_2, sum_4 = np.zeros((3, len(cosine)))
        for order, spectrum in spectra(surface, cosine):
            sum_1 += spectrum * poisson(order, depth)
            sum_2 += spectrum * poisson(order, 2.0 * depth)
            sum_4 += spectrum * poisson(order, 4.0 * depth)
        complementary_power = np.abs(complementary) ** 2 / 4.0 * sum_1
        limit = np.abs(complementary + 4.0 * kirchhoff) ** 2
        backscatter = complementary_power + cross * sum_2 + kirchhoff**2 * np.exp(depth) * sum_4
        # Where the spectrum has underflowed there is no backscatter to share.
        return 1.0 - np.divide(limit * sum_1 / 4.0, backscatter, out=np.ones_like(backscatter), where=backscatter > 0)

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
