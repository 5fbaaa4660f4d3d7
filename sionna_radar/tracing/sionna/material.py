"""Adapter of backscatter models as a radio material of Sionna RT."""

from typing import Any

import numpy as np
from jaxtyping import Float

from sionna_radar.raytracer.backend import load_mitsuba, load_sionna
from sionna_radar.surfaces.backscatter import Backscatter
from sionna_radar.surfaces.radar_material import RadarMaterial, as_radar_material

mi = load_mitsuba()
load_sionna()

import drjit as dr  # noqa: E402  (libLLVM and the variant must be chosen before these load)
import sionna.rt as rt  # noqa: E402
from sionna.rt.constants import InteractionType  # noqa: E402
from sionna.rt.utils import implicit_basis_vector  # noqa: E402

PLUGIN = "sionna-radar-backscatter"
TABLE_SIZE = 2049


class BackscatterMaterial(rt.RadioMaterialBase):
    """A radio material that scatters diffusely with given sigma0 in V, H and cross-polar.

    A ray tube of solid angle W that meets the surface at incidence t illuminates the area r^2 W / cos t, so
    the scattered over the incident field, both at 1 m, is sqrt(sigma0(t) / (4 pi cos t) W). Sionna's
    diffuse matrix uses field components in the world's spherical basis, which is singular at the zenith and
    loses half the power of a linearly polarized antenna pointing straight down; this one acts on the
    transverse field, by the matrix of `RadarMaterial`. With c = k x n, of size sin t, its co-polar part is

        a_v + (a_h - a_v) / sin^2 t c c^T

    in which nothing is singular at nadir, where a_h = a_v. Toward any other direction, the field is this
    vector's transverse part.
    """

    def __init__(self, properties: Any, backscatter: Backscatter) -> None:
        super().__init__(properties)
        material = as_radar_material(backscatter)
        vertical, excess, opposed, exchanged = _amplitudes(material)
        self._vertical = mi.Float(vertical.astype(np.float32))
        # Omitted where they are zero, for speed.
        self._excess = mi.Float(excess.astype(np.float32)) if np.any(excess) else None
        self._cross = mi.Float(exchanged.astype(np.float32)) if np.any(exchanged) or np.any(opposed) else None
        # Where d = x, any axes will do.
        self._opposed = None if material.copolar_correlation is None else mi.Float(opposed.astype(np.float32))

    @property
    def tables(self) -> list[Any]:
        """Amplitudes of the matrix against incidence, as far as it has them."""
        models = (self._vertical, self._excess, self._cross, self._opposed)
        return [table for table in models if table is not None]

    def frequency_update(self) -> None:
        """Do nothing: sigma0 is given at the carrier of the scenario."""

    def sample(self, ctx, si, sample1, sample2, active=True):  # type: ignore[no-untyped-def]
        """Sample a diffuse reflection, the only interaction there is."""
        # The solver encodes the requested interactions in the bits of this float.
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
        """Return the Jones matrix toward `wo`; `si.t` holds the ray tube's solid angle."""
        position = dr.safe_acos(-si.wi.z) * ((TABLE_SIZE - 1) / (np.pi / 2))
        below = mi.UInt32(dr.clip(position, 0, TABLE_SIZE - 2))
        fraction = position - mi.Float(below)

        def at_incidence(table):  # type: ignore[no-untyped-def]
            low = dr.gather(mi.Float, table, below, active)
            return dr.lerp(low, dr.gather(mi.Float, table, below + 1, active), fraction)

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
    """Return a_v, (a_h - a_v) / sin^2, d, x of `ScatteringAmplitudes` at evenly spaced incidence, for 1 sr."""
    incidence = np.linspace(0.0, np.pi / 2, TABLE_SIZE)
    # At grazing incidence the ratio is taken just short of 90 deg, where sigma0 and the cosine both vanish.
    safe = np.minimum(incidence, np.deg2rad(89.99))
    spread = 4 * np.pi * np.cos(safe)
    parts = material.amplitudes(safe, spread)
    excess = np.zeros(TABLE_SIZE)
    excess[1:] = (parts.horizontal - parts.vertical)[1:] / np.sin(safe[1:]) ** 2
    excess[0] = excess[1]
    return parts.vertical, excess, parts.opposed, parts.exchanged


class _Transverse:
    """Matrices that project a field vector from one direction's implicit basis to another's."""

    def __init__(self, k_in, k_out) -> None:  # type: ignore[no-untyped-def]
        self._in = implicit_basis_vector(k_in)
        self._in = (self._in, dr.cross(k_in, self._in))
        self._out = implicit_basis_vector(k_out)
        self._out = (self._out, dr.cross(k_out, self._out))
        (self._ss, self._sp), (self._ps, self._pp) = [[dr.dot(o, i) for i in self._in] for o in self._out]

    @property
    def kept(self):  # type: ignore[no-untyped-def]
        """The field vector unchanged."""
        return mi.Matrix2f([[self._ss, self._sp], [self._ps, self._pp]])

    @property
    def exchanged(self):  # type: ignore[no-untyped-def]
        """Its two components exchanged."""
        return mi.Matrix2f([[self._sp, self._ss], [self._pp, self._ps]])

    @property
    def opposed(self):  # type: ignore[no-untyped-def]
        """Its second component with opposite sign."""
        return mi.Matrix2f([[self._ss, -self._sp], [self._ps, -self._pp]])

    def along(self, axis):  # type: ignore[no-untyped-def]
        """Its part along an axis, times the axis's squared length."""
        return self.between(axis, axis)

    def between(self, shown, seen):  # type: ignore[no-untyped-def]
        """Its part along `seen`, moved to `shown`."""
        return mi.Matrix2f([[dr.dot(shown, o) * dr.dot(seen, i) for i in self._in] for o in self._out])


def _incidence_axes(k_in, normal):  # type: ignore[no-untyped-def]
    """Return unit axes h, v across and in the plane of incidence; any at normal incidence."""
    across = dr.cross(k_in, normal)
    across = dr.normalize(dr.select(dr.squared_norm(across) > 1e-12, across, implicit_basis_vector(k_in)))
    return across, dr.cross(across, k_in)


def _as_four(real, imaginary):  # type: ignore[no-untyped-def]
    """Return a complex Jones matrix as the real one of twice the size used by Sionna."""
    return mi.Matrix4f([[*real[i], *(-imaginary[i])] for i in range(2)] + [[*imaginary[i], *real[i]] for i in range(2)])


def _signs(place):  # type: ignore[no-untyped-def]
    """Return two values +-1 that depend only on position, by a hash of coordinates.

    Multipliers: Teschner and others 2003, "Optimized spatial hashing"; the finaliser is MurmurHash3's.
    """
    x, y, z = (dr.reinterpret_array(mi.UInt32, c) for c in place)
    bits = (x * 73856093) ^ (y * 19349663) ^ (z * 83492791)
    bits = (bits ^ (bits >> 16)) * 0x85EBCA6B
    bits = (bits ^ (bits >> 13)) * 0xC2B2AE35
    bits ^= bits >> 16
    return tuple(dr.select((bits & bit) > 0, mi.Float(1.0), mi.Float(-1.0)) for bit in (1, 2))


def sionna_material(name: str, backscatter: Backscatter) -> rt.RadioMaterialBase:
    """Return a backscatter model as a material of Sionna RT."""
    properties = mi.Properties(PLUGIN)
    properties.set_id(name)
    properties["color"] = mi.ScalarColor3f(0.5, 0.5, 0.5)
    return BackscatterMaterial(properties, backscatter)
