"""Backscatter of surfaces: sigma0 against the local incidence angle."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float


@runtime_checkable
class Backscatter(Protocol):
    """A model of the monostatic backscatter of an extended surface.

    Any object with this method is a model.
    """

    def sigma0(self, incidence_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the radar cross-section per unit of surface area (a ratio) at incidence angles."""
        ...


@runtime_checkable
class ScatteredShare(Protocol):
    """A model that knows its scattering into all directions, not only back."""

    def scattered_share(self, incidence_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return scattered over incident power of the co-polar field at incidence angles."""
        ...


@dataclass(frozen=True)
class ConstantGammaBackscatter:
    """sigma0 = gamma cos(incidence) (Rouveure et al. 2017, eq. 7)."""

    gamma: float

    def sigma0(self, incidence_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the radar cross-section per unit of surface area."""
        return self.gamma * np.cos(incidence_rad)


@dataclass(frozen=True)
class LambertianBackscatter:
    """sigma0 = sigma0(nadir) cos^2(incidence): Lambert's law in the backscatter direction."""

    nadir_sigma0: float

    def sigma0(self, incidence_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the radar cross-section per unit of surface area."""
        return self.nadir_sigma0 * np.cos(incidence_rad) ** 2

    def scattered_share(self, incidence_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return scattered over incident power: the albedo, 1 (and a nadir sigma0 of 4, 6 dB) at most in nature.

        Toward every direction sigma0 is 4 albedo cos(in) cos(out); over 4 pi cos(in), its integral is the albedo.
        """
        return np.full(len(incidence_rad), self.nadir_sigma0 / 4)
