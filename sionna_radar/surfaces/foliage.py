"""Extinction and backscatter of foliage, from the leaf up: a thin dielectric sheet in all directions alike.

A leaf wider than the wavelength is a sheet: of the power that meets it a share |R|^2 is reflected as by a mirror, |T|^2
passes. With a one-sided leaf area A per volume and normals spherically distributed (de Wit 1965, "Photosynthesis of
leaf canopies"), a ray meets A mu dmu leaves per metre with a cosine mu of incidence between 0 and 1, so that power is
lost at the rate

    k = A int_0^1 mu (1 - |T(mu)|^2) dmu,

A / 2 for opaque leaves. Power that a leaf diffracts forward, as much again for an opaque one, stays within a wavelength
over the leaf's width of the ray, and still falls on the ground that the beam illuminates: it is no loss here.
(Of a receiver with a narrow beam far behind the leaves it is: the forward-scattering theorem then gives
A int mu 2 Re(1 - T) dmu, A for opaque leaves.)

The echo is the flash of leaves seen face on. A plate of area a returns sigma = 4 pi a^2 |R|^2 / lambda^2 at normal
incidence, within a solid angle lambda^2 / (4 a) of its normals (the reflected ray turns twice as fast): pi a |R|^2
times the density of normals, 1 / (2 pi), gives a |R|^2 / 2, and per volume

    eta = A |R(1)|^2 / 2.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float
from scipy.constants import speed_of_light

from sionna_radar.surfaces.permittivity import leaf_permittivity

# Nodes of the mean over the leaves' angles; 32 agree with 400 within 1e-6 of the extinction.
NODES = 32


def sheet_coefficients(
    permittivity: complex, thickness_m: float, wavelength_m: float, cosine: Float[np.ndarray, " angle"]
) -> tuple[Complex128[np.ndarray, "2 angle"], Complex128[np.ndarray, "2 angle"]]:
    """Return the reflection and transmission of a dielectric sheet in air, E across the plane of incidence and in it.

    permittivity: eps' - j eps''. Closed form of the multiple reflections between both faces (Ulaby and Long 2014,
    section 2-10).
    """
    inside = np.sqrt(permittivity - 1.0 + cosine**2 + 0j)
    face = np.stack(
        [(cosine - inside) / (cosine + inside), (permittivity * cosine - inside) / (permittivity * cosine + inside)]
    )
    through = np.exp(-2j * np.pi * thickness_m / wavelength_m * inside)
    ringing = 1.0 - face**2 * through**2
    return face * (1.0 - through**2) / ringing, (1.0 - face**2) * through / ringing


@dataclass(frozen=True, kw_only=True)
class Foliage:
    """Leaves that are evenly distributed over a volume, and whose normals are over the sphere.

    leaf_area_per_m: one-sided leaf area per volume.
    leaf_thickness_m: of the leaves. water_content: mass of water over mass of fresh leaf.
    """

    leaf_area_per_m: float
    leaf_thickness_m: float
    water_content: float

    def extinction_per_m(self, carrier_hz: float) -> float:
        """Return the one-way extinction of power, in nepers per metre."""
        node, weight = np.polynomial.legendre.leggauss(NODES)
        cosine = (node + 1) / 2
        passed = np.abs(self._sheet(carrier_hz, cosine)[1]) ** 2
        return self.leaf_area_per_m * float(np.sum(weight / 2 * cosine * (1 - passed.mean(axis=0))))

    def backscatter_per_m(self, carrier_hz: float) -> float:
        """Return the cross-section per volume."""
        reflection = self._sheet(carrier_hz, np.ones(1))[0]
        return self.leaf_area_per_m * float(np.abs(reflection[0, 0]) ** 2) / 2

    def _sheet(
        self, carrier_hz: float, cosine: Float[np.ndarray, " angle"]
    ) -> tuple[Complex128[np.ndarray, "2 angle"], Complex128[np.ndarray, "2 angle"]]:
        permittivity = leaf_permittivity(carrier_hz, water_content=self.water_content)
        return sheet_coefficients(permittivity, self.leaf_thickness_m, speed_of_light / carrier_hz, cosine)
