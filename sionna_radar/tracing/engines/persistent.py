"""The persistent engine: scatterers fixed to the surface, so that phase from chirp to chirp is that of a real scene.

Each pulse sees the scatterers within its beam, truncated in azimuth and in elevation, that a ray reaches. Their fields
come from the same material, antenna and field calculator as the beam engine's: a scatterer of area A at range r and
incidence t represents the solid angle A cos t / r^2. Ranges, and with them phases, are float64.

What the scatterers leave out, some thousandths of the echo, is traced by a few rays that are drawn anew in each pulse
(see `outer_rays`): the skirts and side lobes of the beam carry their power, but no history of phase.

On a surface that moves each scatterer has a Doppler shift of its own; see `wander`.
"""

from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.columns import Columns
from sionna_radar.foundation.randomness import Stream, pulse_uniforms
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.radar.main_lobe import reach_of_power
from sionna_radar.scene.model import Scene
from sionna_radar.tracing.engines.density import OUTSIDE_SHARE, DensityMap
from sionna_radar.tracing.engines.outer_rays import OuterRays, in_reach
from sionna_radar.tracing.engines.scatterers import Scatterers
from sionna_radar.tracing.paths import Paths
from sionna_radar.tracing.sionna.contract import check_sionna
from sionna_radar.tracing.sionna.fields import calculate_fields, diffuse_buffer
from sionna_radar.tracing.sionna.material import mi
from sionna_radar.tracing.sionna.pattern import sionna_angles
from sionna_radar.tracing.sionna.scene import SionnaScene
from sionna_radar.tracing.wander import wander_hz

# isort: split
# Loads libLLVM, which the import above has selected.
import drjit as dr

# A ray to a scatterer stops this far short of it, so that the scatterer's own triangle does not hide it.
SHORT_OF_SURFACE = 1e-4
OUTER_RAYS = 26


@dataclass(frozen=True, kw_only=True)
class _Candidates(Columns):
    """Paths before their fields are known.

    row: of the pulse in its block.
    factor: of the field.
    found: whether a ray has met the surface there; else one has to be sent to see whether it is hidden.
    """

    row: Int[np.ndarray, " path"]
    hit_m: Float[np.ndarray, "path 3"]
    range_rate_mps: Float[np.ndarray, " path"]
    cosine: Float[np.ndarray, " path"]
    solid_angle_sr: Float[np.ndarray, " path"]
    surface: Int[np.ndarray, " path"]
    face: Int[np.ndarray, " path"]
    factor: Complex[np.ndarray, " path"]
    found: Bool[np.ndarray, " path"]


class PersistentEngine:
    """Traces blocks of pulses over fixed scatterers; see the module docstring.

    density: where there are how many scatterers per square metre of surface; a number for the same everywhere.
    region_m: box that the survey can see; scatterers lie inside it only.
    outer_rays: rays a pulse beside the scatterers.
    decorrelation_time_s: after which the field's correlation has fallen to 1 / e; None for a surface that stands still.
    """

    def __init__(
        self,
        scene: Scene,
        antenna: Antenna,
        chirp: Chirp,
        seed: int,
        density: DensityMap | float,
        region_m: Float[np.ndarray, "2 3"] | None = None,
        *,
        outer_rays: int = OUTER_RAYS,
        decorrelation_time_s: float | None = None,
    ) -> None:
        check_sionna()
        self._sionna = SionnaScene(scene, antenna, chirp.carrier_hz)
        self._density = density if isinstance(density, DensityMap) else DensityMap.constant(density)
        self._scatterers = Scatterers(scene, self._density, seed, region_m)
        self._region_m, self._seed, self._outer_rays = region_m, seed, outer_rays
        self._wander_hz = 0.0 if decorrelation_time_s is None else wander_hz(decorrelation_time_s)
        self._look_through(antenna)

    def with_antenna(self, antenna: Antenna) -> "PersistentEngine":
        """Return the engine with another antenna, over the same scatterers."""
        other = copy(self)
        other._sionna = self._sionna.with_antenna(antenna)
        other._look_through(antenna)
        return other

    def _look_through(self, antenna: Antenna) -> None:
        self._reach = reach_of_power(antenna, OUTSIDE_SHARE)
        self._outer = OuterRays(antenna, self._reach, self._outer_rays, self._seed)

    def trace(self, pulses: Pulses) -> Paths:
        """Return the paths of a block of pulses, sorted by pulse: its scatterers, then its other rays."""
        return self._fields(pulses, _Candidates.concatenate([self._fixed(pulses), self._outside(pulses)]))

    def _fixed(self, pulses: Pulses) -> _Candidates:
        """Return the scatterers in the beams."""
        seen = self._scatterers.in_beams(pulses.true, self._reach)
        points = self._scatterers.kept[seen["which"]]
        factor = points["reflectivity"]
        if self._wander_hz:
            turn = points["wander"].astype(np.float64) * self._wander_hz * pulses.time_s[seen["row"]]
            factor = factor * np.exp(2j * np.pi * np.mod(turn, 1.0)).astype(np.complex64)
        return _Candidates(
            row=seen["row"],
            hit_m=points["position_m"],
            range_rate_mps=seen["range_rate_mps"],
            cosine=seen["cosine"],
            solid_angle_sr=seen["solid_angle_sr"],
            surface=points["surface"],
            face=points["face"],
            factor=factor,
            found=np.zeros(len(seen), dtype=bool),
        )

    def _outside(self, pulses: Pulses) -> _Candidates:
        """Return where the rays beside the scatterers meet a surface."""
        pose, rays = pulses.true, self._outer.rays
        within, per_sr = self._outer.shoot(pulses.index)
        row = np.repeat(np.arange(len(pulses), dtype=np.uint32), rays)
        direction = np.einsum("nij,nj->ni", pose.R_world_antenna[row], within)
        ray = mi.Ray3f(_points(pose.position_m[row]), mi.Vector3f(*_points(direction)))
        hit = self._sionna.rt_scene.mi_scene.ray_intersect(ray)
        shape = dr.reinterpret_array(mi.UInt32, hit.shape)
        cosine = dr.minimum(dr.abs(dr.dot(hit.n, ray.d)), 1.0)
        dr.eval(hit.t, hit.prim_index, shape, cosine)
        used = np.isfinite(hit.t.numpy()) & (per_sr > 0)
        distance = np.where(used, hit.t.numpy(), 0.0).astype(np.float64)
        place = pose.position_m[row] + distance[:, None] * direction
        used &= ~(in_reach(within, self._reach) & self._bears_scatterers(place))
        phase = pulse_uniforms(self._seed, Stream.SPECKLE, pulses.index, rays).ravel()[used]
        own = row[used]
        return _Candidates(
            row=own,
            hit_m=place[used],
            range_rate_mps=-np.einsum("ni,ni->n", pose.velocity_mps[own], direction[used]).astype(np.float32),
            cosine=cosine.numpy()[used],
            solid_angle_sr=(1 / per_sr[used]).astype(np.float32),
            surface=self._sionna.surface_of_shape[shape.numpy()[used]].astype(np.int32),
            face=hit.prim_index.numpy()[used].astype(np.int32),
            factor=np.exp(2j * np.pi * phase).astype(np.complex64),
            found=np.ones(len(own), dtype=bool),
        )

    def _bears_scatterers(self, place_m: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        bears = self._density.at(place_m[:, :2]) > 0
        if self._region_m is not None:
            bears &= np.all((place_m >= self._region_m[0]) & (place_m <= self._region_m[1]), axis=1)
        return bears

    def _fields(self, pulses: Pulses, seen: _Candidates) -> Paths:
        """Return the paths of what is not hidden, with their fields."""
        gain, visible = self._gains(pulses, seen)
        # Sorting 16 bits takes one pass over them.
        order = np.argsort(seen.row.astype(np.uint16 if len(pulses) < 2**16 else np.uint32), kind="stable")
        kept = seen.rows(order[visible[order]])
        gain = np.multiply(gain, seen.factor)[order[visible[order]]]
        return Paths.to_points(
            pulses,
            kept.row,
            kept.hit_m,
            gain=gain,
            incidence_rad=np.arccos(kept.cosine),
            surface=kept.surface,
        )

    def _gains(
        self, pulses: Pulses, seen: _Candidates
    ) -> tuple[Complex[np.ndarray, " path"], Bool[np.ndarray, " path"]]:
        """Return the field of each path for a factor of one, and whether it is visible."""
        if len(seen) == 0:  # Dr.Jit does not accept empty arrays together with scalars
            return np.zeros(0, dtype=np.complex64), np.zeros(0, dtype=bool)
        apex, row = _points(pulses.true.position_m), mi.UInt32(seen.row)
        position = _points(seen.hit_m)
        origin = dr.gather(mi.Point3f, apex, row)
        away = position - origin
        distance = dr.norm(away)
        ray = mi.Ray3f(origin, away / distance)
        ray.maxt = distance * (1 - SHORT_OF_SURFACE)
        visible = ~self._sionna.rt_scene.mi_scene.ray_test(ray, ~mi.Bool(seen.found))
        buffer = diffuse_buffer(
            row,
            position,
            mi.UInt32(self._sionna.shape_of_surface[seen.surface].astype(np.uint32)),
            mi.UInt32(seen.face.astype(np.uint32)),
            mi.Float((4 * np.pi / np.maximum(seen.solid_angle_sr, 1e-30)).astype(np.float32)),
            visible,
        )
        found = calculate_fields(self._sionna, buffer, apex, _points(sionna_angles(pulses.true.R_world_antenna)))
        gain = found.a[0][0]
        dr.eval(gain, visible)
        out = np.empty(len(seen), dtype=np.complex64)
        out.real, out.imag = gain.real.numpy(), gain.imag.numpy()
        return out, visible.numpy()


def _points(array: Float[np.ndarray, "n 3"]) -> Any:
    return mi.Point3f(array.T.astype(np.float32))
