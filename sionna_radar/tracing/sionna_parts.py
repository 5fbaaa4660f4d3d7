"""Sionna RT's side of a scene: our backscatter material, our antenna pattern, and the scene made of them."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from sionna_radar.radar.antenna import Antenna, Cut
from sionna_radar.scene.backend import load_mitsuba
from sionna_radar.scene.backscatter import Backscatter
from sionna_radar.scene.model import Scene
from sionna_radar.scene.raycast import mitsuba_mesh

mi = load_mitsuba()

import drjit as dr  # noqa: E402  (libLLVM and the variant must be chosen before these load)
import sionna.rt as rt  # noqa: E402
from sionna.rt.constants import InteractionType  # noqa: E402
from sionna.rt.utils import implicit_basis_vector  # noqa: E402

PLUGIN = "sionna-radar-backscatter"
TABLE_SIZE = 2049


class BackscatterMaterial(rt.RadioMaterialBase):
    """A radio material that scatters diffusely with a given sigma0.

    A ray tube of solid angle W that meets the surface at incidence t illuminates the area r^2 W / cos t, so
    the scattered over the incident field, both at 1 m, is sqrt(sigma0(t) / (4 pi cos t) W). Sionna's own
    diffuse matrix keeps field components in the world's spherical basis, which is singular at the zenith and
    loses half the power of a linearly polarised antenna that looks straight down; this one keeps the
    transverse field vector itself.
    """

    def __init__(self, properties: Any, backscatter: Backscatter) -> None:
        super().__init__(properties)
        incidence = np.linspace(0.0, np.pi / 2, TABLE_SIZE)
        # At grazing the ratio is taken just short of the horizon, where sigma0 and the cosine both vanish.
        safe = np.minimum(incidence, np.deg2rad(89.99))
        amplitude = np.sqrt(backscatter.sigma0(safe) / (4 * np.pi * np.cos(safe)))
        self._amplitude = mi.Float(amplitude.astype(np.float32))

    def frequency_update(self) -> None:
        """Do nothing: sigma0 is given at the carrier of the scenario."""

    def sample(self, ctx, si, sample1, sample2, active=True):  # type: ignore[no-untyped-def]
        """Sample a diffuse reflection, the only interaction there is."""
        # The solver says which interactions it wants in the bits of this float.
        wanted = (dr.reinterpret_array(mi.UInt32, si.dp_du.z) & InteractionType.DIFFUSE) > 0
        width = dr.width(si.wi)
        sample = mi.BSDFSample3f()
        sample.sampled_component = dr.select(
            wanted, dr.full(mi.UInt32, InteractionType.DIFFUSE, width), InteractionType.NONE
        )
        sample.wo = si.to_world(mi.warp.square_to_uniform_hemisphere(sample2))
        sample.pdf = dr.select(wanted, dr.ones(mi.Float, width), 0.0)
        sample.sampled_type = mi.UInt32(+mi.BSDFFlags.DeltaReflection)
        sample.eta = 1.0
        return sample, mi.Spectrum(0.0)

    def eval(self, ctx, si, wo, active=True):  # type: ignore[no-untyped-def]
        """Return the Jones matrix toward `wo`, with the solid angle of the ray tube in `si.t`."""
        incidence = dr.safe_acos(-si.wi.z)
        position = incidence * ((TABLE_SIZE - 1) / (np.pi / 2))
        below = mi.UInt32(dr.clip(position, 0, TABLE_SIZE - 2))
        share = position - mi.Float(below)
        low = dr.gather(mi.Float, self._amplitude, below, active)
        high = dr.gather(mi.Float, self._amplitude, below + 1, active)
        outward = dr.dot(wo, si.n) > 0
        diffuse = dr.reinterpret_array(mi.UInt32, si.dp_du.z) == InteractionType.DIFFUSE
        amplitude = dr.select(outward & diffuse, dr.lerp(low, high, share) * dr.sqrt(si.t), 0.0)
        return mi.Spectrum(_transverse_field(si.to_world(si.wi), wo) * amplitude)

    def pdf(self, ctx, si, wo, active=True):  # type: ignore[no-untyped-def]
        """Return the probability of a diffuse reflection."""
        wanted = (dr.reinterpret_array(mi.UInt32, si.dp_du.z) & InteractionType.DIFFUSE) > 0
        return dr.select(wanted, dr.ones(mi.Float, dr.width(si.wi)), 0.0)

    def traverse(self, callback):  # type: ignore[no-untyped-def]
        """Expose nothing: the material has no parameter to differentiate."""

    def to_string(self) -> str:
        """Return a description."""
        return f"BackscatterMaterial[{self.id()}]"


def _transverse_field(k_in, k_out):  # type: ignore[no-untyped-def]
    """Return the Jones matrix that carries a field vector from one implicit basis to another."""
    s_in, s_out = implicit_basis_vector(k_in), implicit_basis_vector(k_out)
    p_in, p_out = dr.cross(k_in, s_in), dr.cross(k_out, s_out)
    ss, sp = dr.dot(s_out, s_in), dr.dot(s_out, p_in)
    ps, pp = dr.dot(p_out, s_in), dr.dot(p_out, p_in)
    return mi.Matrix4f([[ss, sp, 0, 0], [ps, pp, 0, 0], [0, 0, ss, sp], [0, 0, ps, pp]])


class SeparablePattern(rt.AntennaPattern):
    """An antenna of ours as a Sionna antenna pattern; |c|^2 is the power gain."""

    def __init__(self, antenna: Antenna) -> None:
        azimuth, elevation = (mi.Float(c.voltage.astype(np.float32)) for c in _cuts(antenna))
        peak = float(np.sqrt(antenna.peak_gain))

        def pattern(theta, phi):  # type: ignore[no-untyped-def]
            sin_theta, cos_theta = dr.sincos(theta)
            sin_phi, cos_phi = dr.sincos(phi)
            cos_boresight = sin_theta * cos_phi
            voltage = _lookup(azimuth, sin_theta * sin_phi) * _lookup(elevation, cos_theta)
            voltage *= peak * dr.sqrt(dr.maximum(cos_boresight, 0.0))
            zero = dr.zeros(mi.Float, dr.width(voltage))
            along, across = mi.Complex2f(voltage, zero), mi.Complex2f(zero, zero)
            return (along, across) if antenna.polarization == "V" else (across, along)

        self.patterns = [pattern]


def _cuts(antenna: Antenna) -> tuple[Cut, Cut]:
    return antenna.azimuth, antenna.elevation


def _lookup(table, cosine):  # type: ignore[no-untyped-def]
    position = (dr.clip(cosine, -1.0, 1.0) + 1.0) * ((dr.width(table) - 1) / 2)
    below = mi.UInt32(dr.minimum(position, dr.width(table) - 2))
    share = position - mi.Float(below)
    return dr.lerp(dr.gather(mi.Float, table, below), dr.gather(mi.Float, table, below + 1), share)


class SionnaScene:
    """A scene of ours inside Sionna RT.

    shape_of_surface: Mitsuba's shape pointer, as an integer, of each surface of ours.
    surface_of_shape: the reverse; -1 where there is none.
    """

    def __init__(self, scene: Scene, antenna: Antenna, carrier_hz: float) -> None:
        materials = {name: _material(name, model) for name, model in scene.materials.items()}
        self.rt_scene = rt.Scene()
        objects = [
            rt.SceneObject(mi_mesh=mitsuba_mesh(s), name=f"surface-{i}", radio_material=materials[s.material])
            for i, s in enumerate(scene.surfaces)
        ]
        self.rt_scene.edit(add=objects)
        self.rt_scene.frequency = carrier_hz
        self.pattern = SeparablePattern(antenna)
        shapes = [self.rt_scene.objects[f"surface-{i}"].object_id for i in range(len(objects))]
        self.shape_of_surface: Int[np.ndarray, " surface"] = np.array(shapes)
        self.surface_of_shape: Int[np.ndarray, " shape"] = np.full(max(shapes) + 1, -1)
        self.surface_of_shape[shapes] = np.arange(len(shapes))


def _material(name: str, backscatter: Backscatter) -> BackscatterMaterial:
    properties = mi.Properties(PLUGIN)
    properties.set_id(name)
    properties["color"] = mi.ScalarColor3f(0.5, 0.5, 0.5)
    return BackscatterMaterial(properties, backscatter)


def sionna_angles(R_world_antenna: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 3"]:
    """Return the turns about z, y and x that Sionna describes an orientation by."""
    # A beam straight down is a gimbal lock: any split of the turn is right, and the warning says nothing.
    return Rotation.from_matrix(R_world_antenna).as_euler("ZYX", suppress_warnings=True)
