"""Sionna RT's side of a scene: our backscatter material, our antenna pattern, and the scene made of them."""

from typing import Any

import numpy as np
from jaxtyping import Float, Inexact, Int
from scipy.spatial.transform import Rotation

from sionna_radar.radar.antenna import Antenna, Cut
from sionna_radar.raytracer.backend import load_mitsuba
from sionna_radar.scene.model import Scene
from sionna_radar.scene.raycast import mitsuba_mesh
from sionna_radar.surfaces.backscatter import Backscatter
from sionna_radar.surfaces.radar_material import RadarMaterial, as_radar_material

mi = load_mitsuba()

import drjit as dr  # noqa: E402  (libLLVM and the variant must be chosen before these load)
import sionna.rt as rt  # noqa: E402
from sionna.rt.constants import InteractionType  # noqa: E402
from sionna.rt.utils import implicit_basis_vector  # noqa: E402

PLUGIN = "sionna-radar-backscatter"
TABLE_SIZE = 2049


class BackscatterMaterial(rt.RadioMaterialBase):
    """A radio material that scatters diffusely with given sigma0 in V, H and cross-polar.

    A ray tube of solid angle W that meets the surface at incidence t illuminates the area r^2 W / cos t, so
    the scattered over the incident field, both at 1 m, is sqrt(sigma0(t) / (4 pi cos t) W). Sionna's own
    diffuse matrix keeps field components in the world's spherical basis, which is singular at the zenith and
    loses half the power of a linearly polarised antenna that looks straight down; this one acts on the
    transverse field vector itself, by the matrix of `RadarMaterial`. With c = k x n, of size sin t, that is

        a_v + (a_h - a_v) / sin^2 t c c^T

    in which nothing is singular at nadir, where a_h = a_v. The field toward any other direction is the same
    vector, projected across it.
    """

    def __init__(self, properties: Any, backscatter: Backscatter) -> None:
        super().__init__(properties)
        material = as_radar_material(backscatter)
        vertical, excess, opposed, exchanged = _amplitudes(material)
        self._vertical = mi.Float(vertical.astype(np.float32))
        # Left out where they are zero, for speed.
        self._excess = mi.Float(excess.astype(np.float32)) if np.any(excess) else None
        self._cross = mi.Float(exchanged.astype(np.float32)) if np.any(exchanged) or np.any(opposed) else None
        # With both alike any axes will do.
        self._opposed = None if material.copolar_correlation is None else mi.Float(opposed.astype(np.float32))

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
        position = dr.safe_acos(-si.wi.z) * ((TABLE_SIZE - 1) / (np.pi / 2))
        below = mi.UInt32(dr.clip(position, 0, TABLE_SIZE - 2))
        share = position - mi.Float(below)

        def at_incidence(table):  # type: ignore[no-untyped-def]
            low = dr.gather(mi.Float, table, below, active)
            return dr.lerp(low, dr.gather(mi.Float, table, below + 1, active), share)

        outward = dr.dot(wo, si.n) > 0
        diffuse = dr.reinterpret_array(mi.UInt32, si.dp_du.z) == InteractionType.DIFFUSE
        scale = dr.select(outward & diffuse, dr.sqrt(si.t), 0.0)
        k_in = si.to_world(si.wi)
        turn = _Transverse(k_in, wo)
        real = turn.kept * at_incidence(self._vertical)
        if self._excess is not None:
            real += turn.along(dr.cross(k_in, si.n)) * at_incidence(self._excess)
        if self._cross is None:
            return mi.Spectrum(_as_four(real * scale, mi.Matrix2f(0.0)))
        cross, (one, two) = at_incidence(self._cross), _signs(si.p)
        if self._opposed is None:
            real += turn.exchanged * (two * cross)
            return mi.Spectrum(_as_four(real * scale, turn.opposed * (one * cross * scale)))
        across, within = _incidence_axes(k_in, si.n)
        real += (turn.between(across, within) + turn.between(within, across)) * (two * cross)
        opposed = turn.between(across, across) - turn.between(within, within)
        return mi.Spectrum(_as_four(real * scale, opposed * (one * at_incidence(self._opposed) * scale)))

    def pdf(self, ctx, si, wo, active=True):  # type: ignore[no-untyped-def]
        """Return the probability of a diffuse reflection."""
        wanted = (dr.reinterpret_array(mi.UInt32, si.dp_du.z) & InteractionType.DIFFUSE) > 0
        return dr.select(wanted, dr.ones(mi.Float, dr.width(si.wi)), 0.0)

    def traverse(self, callback):  # type: ignore[no-untyped-def]
        """Expose nothing: the material has no parameter to differentiate."""

    def to_string(self) -> str:
        """Return a description."""
        return f"BackscatterMaterial[{self.id()}]"


def _amplitudes(
    material: RadarMaterial,
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return a_v, (a_h - a_v) / sin^2, d and x at evenly spaced incidence angles, for a solid angle of one."""
    incidence = np.linspace(0.0, np.pi / 2, TABLE_SIZE)
    # At grazing the ratio is taken just short of the horizon, where sigma0 and the cosine both vanish.
    safe = np.minimum(incidence, np.deg2rad(89.99))
    spread = 4 * np.pi * np.cos(safe)
    parts = material.parts(safe, spread)
    excess = np.zeros(TABLE_SIZE)
    excess[1:] = (parts.horizontal - parts.vertical)[1:] / np.sin(safe[1:]) ** 2
    excess[0] = excess[1]
    return parts.vertical, excess, parts.opposed, parts.exchanged


class _Transverse:
    """Matrices that carry a field vector, projected, from one direction's implicit basis to another's."""

    def __init__(self, k_in, k_out) -> None:  # type: ignore[no-untyped-def]
        self._in = implicit_basis_vector(k_in)
        self._in = (self._in, dr.cross(k_in, self._in))
        self._out = implicit_basis_vector(k_out)
        self._out = (self._out, dr.cross(k_out, self._out))
        (self._ss, self._sp), (self._ps, self._pp) = [[dr.dot(o, i) for i in self._in] for o in self._out]

    @property
    def kept(self):  # type: ignore[no-untyped-def]
        """The field vector as it came."""
        return mi.Matrix2f([[self._ss, self._sp], [self._ps, self._pp]])

    @property
    def exchanged(self):  # type: ignore[no-untyped-def]
        """Its two components exchanged."""
        return mi.Matrix2f([[self._sp, self._ss], [self._pp, self._ps]])

    @property
    def opposed(self):  # type: ignore[no-untyped-def]
        """Its second component turned round."""
        return mi.Matrix2f([[self._ss, -self._sp], [self._ps, -self._pp]])

    def along(self, axis):  # type: ignore[no-untyped-def]
        """Its part along an axis, times the axis's size squared."""
        return self.between(axis, axis)

    def between(self, shown, seen):  # type: ignore[no-untyped-def]
        """Its part along one axis, put along another."""
        return mi.Matrix2f([[dr.dot(shown, o) * dr.dot(seen, i) for i in self._in] for o in self._out])


def _incidence_axes(k_in, normal):  # type: ignore[no-untyped-def]
    """Return unit axes across the plane of incidence and in it; any two straight down."""
    across = dr.cross(k_in, normal)
    across = dr.normalize(dr.select(dr.squared_norm(across) > 1e-12, across, implicit_basis_vector(k_in)))
    return across, dr.cross(across, k_in)


def _as_four(real, imaginary):  # type: ignore[no-untyped-def]
    """Return a complex Jones matrix as the real one of twice the size that Sionna works with."""
    return mi.Matrix4f([[*real[i], *(-imaginary[i])] for i in range(2)] + [[*imaginary[i], *real[i]] for i in range(2)])


def _signs(place):  # type: ignore[no-untyped-def]
    """Return two signs that depend on a place alone: its coordinates' bits, hashed.

    Multipliers: Teschner and others 2003, "Optimized spatial hashing"; the finish is MurmurHash3's.
    """
    x, y, z = (dr.reinterpret_array(mi.UInt32, c) for c in place)
    bits = (x * 73856093) ^ (y * 19349663) ^ (z * 83492791)
    bits = (bits ^ (bits >> 16)) * 0x85EBCA6B
    bits = (bits ^ (bits >> 13)) * 0xC2B2AE35
    bits ^= bits >> 16
    return tuple(dr.select((bits & bit) > 0, mi.Float(1.0), mi.Float(-1.0)) for bit in (1, 2))


class SeparablePattern(rt.AntennaPattern):
    """An antenna of ours as a Sionna antenna pattern; |c|^2 is the power gain.

    jones: shares of the field along Sionna's two axes, theta (ours for V, turned downward) and phi; None for what the
    antenna sends.
    """

    def __init__(self, antenna: Antenna, jones: Inexact[np.ndarray, "2"] | None = None) -> None:
        # With one axis turned round, the hands of a circular wave change places.
        shares = (np.conj(antenna.jones[0]) if jones is None else jones).astype(complex).tolist()
        azimuth, elevation = (mi.Float(c.voltage.astype(np.float32)) for c in _cuts(antenna))
        peak = float(np.sqrt(antenna.peak_gain))

        def pattern(theta, phi):  # type: ignore[no-untyped-def]
            sin_theta, cos_theta = dr.sincos(theta)
            sin_phi, cos_phi = dr.sincos(phi)
            cos_boresight = sin_theta * cos_phi
            voltage = _lookup(azimuth, sin_theta * sin_phi) * _lookup(elevation, cos_theta)
            voltage *= peak * dr.sqrt(dr.maximum(cos_boresight, 0.0))
            return tuple(mi.Complex2f(voltage * share.real, voltage * share.imag) for share in shares)

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

    pattern, receive_pattern: the antenna as it sends and as it receives.
    shape_of_surface: Mitsuba's shape pointer, as an integer, of each surface of ours.
    surface_of_shape: the reverse; -1 where there is none.
    """

    def __init__(self, scene: Scene, antenna: Antenna, carrier_hz: float) -> None:
        # Sionna knows materials and objects by names from one list: those of the user's stay out of it.
        materials = {
            name: _material(f"material-{number}", model) for number, (name, model) in enumerate(scene.materials.items())
        }
        self.rt_scene = rt.Scene()
        # Before the materials arrive, some of which are undefined at Sionna's default frequency.
        self.rt_scene.frequency = carrier_hz
        objects = [
            rt.SceneObject(mi_mesh=mitsuba_mesh(s), name=f"surface-{i}", radio_material=materials[s.material])
            for i, s in enumerate(scene.surfaces)
        ]
        self.rt_scene.edit(add=objects)
        self.pattern = SeparablePattern(antenna)
        # Sionna receives by the conjugate of the pattern: what is conjugated for its axes stays as it is.
        self.receive_pattern = SeparablePattern(antenna, antenna.jones[1])
        shapes = [self.rt_scene.objects[f"surface-{i}"].object_id for i in range(len(objects))]
        self.shape_of_surface: Int[np.ndarray, " surface"] = np.array(shapes)
        self.surface_of_shape: Int[np.ndarray, " shape"] = np.full(max(shapes) + 1, -1)
        self.surface_of_shape[shapes] = np.arange(len(shapes))


def _material(name: str, backscatter: Backscatter) -> rt.RadioMaterialBase:
    properties = mi.Properties(PLUGIN)
    properties.set_id(name)
    properties["color"] = mi.ScalarColor3f(0.5, 0.5, 0.5)
    return BackscatterMaterial(properties, backscatter)


def sionna_angles(R_world_antenna: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 3"]:
    """Return the turns about z, y and x that Sionna describes an orientation by."""
    # A beam straight down is a gimbal lock: any split of the turn is right, and the warning says nothing.
    return Rotation.from_matrix(R_world_antenna).as_euler("ZYX", suppress_warnings=True)
