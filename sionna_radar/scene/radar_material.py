"""What a surface does to the radar's wave: V, H and cross-polar backscatter, and a mirror reflection.

Scattering matrix of a small piece of the surface, in its own axes (h across the plane of incidence, v in it)
and the same for both ways:

    | a_h  0  |       | j s1   s2   |
    |  0  a_v |  + x  | s2   -j s1  |      s1, s2 = +-1, drawn for each place

The second part carries the cross-polar power x^2. It is symmetric, so VH equals HV (reciprocity), and turning
the axes only turns its phase, on average over the signs: at nadir, where the axes are arbitrary, nothing depends
on them. It adds x^2 to the co-polar channels too, which a_h and a_v leave room for.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.constants import speed_of_light

from sionna_radar.scene.backscatter import Backscatter, ScatteredShare
from sionna_radar.scene.rough_surface import coherent_power_factor, fresnel_reflection

Channel = Literal["VV", "HH", "VH", "HV"]


@dataclass(frozen=True, kw_only=True)
class Mirror:
    """The coherent reflection of a plane, rough or smooth, at right angles."""

    permittivity: complex
    rms_height_m: float
    frequency_hz: float

    @property
    def amplitude(self) -> complex:
        """Reflected over incident field, both along the same axis: Fresnel's times what roughness leaves."""
        factor = 1.0
        if self.rms_height_m > 0:
            factor = float(coherent_power_factor(self.rms_height_m, self.frequency_hz, np.zeros(1))[0])
        smooth = complex(fresnel_reflection(self.permittivity, np.ones(1), "H")[0])
        return smooth * factor**0.5


@dataclass(frozen=True, kw_only=True)
class RadarMaterial:
    """A surface's backscatter in every channel; it is a `Backscatter` itself, of the channel in use.

    vertical, horizontal: co-polar sigma0 for a field in the plane of incidence and across it.
    cross_polar: cross-polar sigma0 over the weaker of the two.
    channel: what the radar sends and receives (VH: receives V of a sent H; equal to HV).
    mirror: None for a surface without a specular return.
    """

    vertical: Backscatter
    horizontal: Backscatter
    cross_polar: float = 0.0
    channel: Channel = "VV"
    mirror: Mirror | None = None

    def sigma0(self, incidence_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the cross-section per unit of surface area in the channel."""
        if self.channel in ("VH", "HV"):
            return self.cross_sigma0(incidence_rad)
        return self.co_polar.sigma0(incidence_rad)

    def cross_sigma0(self, incidence_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the cross-polar cross-section per unit of surface area."""
        vertical, horizontal = (m.sigma0(incidence_rad) for m in (self.vertical, self.horizontal))
        return self.cross_polar * np.minimum(vertical, horizontal)

    @property
    def co_polar(self) -> Backscatter:
        """The co-polar backscatter of the polarisation that the radar sends."""
        return self.vertical if self.channel in ("VV", "HV") else self.horizontal

    def scattered_share(self, incidence_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return scattered over incident power, mirror included, the larger of a sent V and H.

        A model that knows where its power goes says so by its own method `scattered_share`. Of any other only
        the backscatter is known: it is taken to re-radiate its field into every direction of the hemisphere alike,
        projected across the direction, which is what the ray tracer's material does: sigma0 / (4 pi cos) times the
        solid angle 4 pi / 3 that the projection leaves. The cross-polar field is one more.
        """
        cosine = np.maximum(np.cos(incidence_rad), 1e-9)
        shares = []
        for model in (self.vertical, self.horizontal):
            if isinstance(model, ScatteredShare):
                shares.append(model.scattered_share(incidence_rad) * (1 + self.cross_polar))
            else:
                shares.append((model.sigma0(incidence_rad) + self.cross_sigma0(incidence_rad)) / (3 * cosine))
        share: Float[np.ndarray, " n"] = np.maximum(*shares)
        if self.mirror is not None:
            share = share + self._reflected_share(self.mirror, incidence_rad)
        return share

    @staticmethod
    def _reflected_share(mirror: Mirror, incidence_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        cosine = np.cos(incidence_rad)
        strongest = np.maximum(*(np.abs(fresnel_reflection(mirror.permittivity, cosine, p)) ** 2 for p in ("V", "H")))
        phase = 4 * np.pi * mirror.frequency_hz / speed_of_light * mirror.rms_height_m * cosine
        reflected: Float[np.ndarray, " n"] = strongest * np.exp(-(phase**2))
        return reflected


def as_radar_material(backscatter: Backscatter) -> RadarMaterial:
    """Return a backscatter model as a material that treats V and H alike, unless it is a material already."""
    if isinstance(backscatter, RadarMaterial):
        return backscatter
    return RadarMaterial(vertical=backscatter, horizontal=backscatter)
