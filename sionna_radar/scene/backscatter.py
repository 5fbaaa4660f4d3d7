"""How strongly a surface scatters back: sigma0 against the local incidence angle."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float


@runtime_checkable
class Backscatter(Protocol):
    """A model of the monostatic backscatter of an extended surface.

    A model of one's own is any object with this method.
    """

    def sigma0(self, incidence_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the radar cross-section per unit of surface area (a ratio) at incidence angles."""
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
    """sigma0 = sigma0(nadir) cos^2(incidence): Lambert's law, seen back along the ray."""

    nadir_sigma0: float

    def sigma0(self, incidence_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the radar cross-section per unit of surface area."""
        return self.nadir_sigma0 * np.cos(incidence_rad) ** 2
