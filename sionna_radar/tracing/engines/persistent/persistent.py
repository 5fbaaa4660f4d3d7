"""The persistent engine: scatterers fixed to the surface, so that phase from chirp to chirp is that of a real scene.

Each pulse sees the scatterers within its beam, truncated in azimuth and in elevation, that a ray reaches. Their fields
come from the same material, antenna and field calculator as the beam engine's: a scatterer of area A at range r and
incidence t represents the solid angle A cos t / r^2. Ranges, and with them phases, are float64.

What the scatterers leave out, some thousandths of the echo, is traced by a few rays that are drawn anew in each pulse
(see `outer_rays`): the skirts and side lobes of the beam carry their power, but no history of phase.

On a surface that moves each scatterer has a Doppler shift of its own; see `tracing.paths`.
"""

from collections.abc import Iterator
from copy import copy
from typing import Any

import numpy as np
from jaxtyping import Bool, Complex, Float, Int
from scipy.constants import speed_of_light

from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.randomness import Stream, pulse_uniforms
from sionna_radar.foundation.threads import beside
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.raytracer.backend import flushed_denormals
from sionna_radar.scene.model import Scene
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.tracing.engines.persistent.density import DensityMap, filled_beam
from sionna_radar.tracing.engines.persistent.mirrored_places import MirroredPlaces
from sionna_radar.tracing.engines.persistent.outer_rays import OuterRays
from sionna_radar.tracing.engines.persistent.scatterers import Scatterers
from sionna_radar.tracing.engines.persistent.seen_places import SeenPlaces
from sionna_radar.tracing.paths import DevicePaths, Paths, wander_hz
from sionna_radar.tracing.sionna.contract import check_sionna
from sionna_radar.tracing.sionna.fields import calculate_fields, diffuse_buffer
from sionna_radar.tracing.sionna.material import mi
from sionna_radar.tracing.sionna.pattern import sionna_angles
from sionna_radar.tracing.sionna.scene import sionna_scene

# isort: split
# Loads libLLVM, which an import above has selected.
import drjit as dr

# A ray to a scatterer stops this far short of it, so that the scatterer's own triangle does not hide it.
SHORT_OF_SURFACE = 1e-4
OUTER_RAYS = 26


class PersistentEngine:
    """Traces blocks of pulses over fixed scatterers; see the module docstring.

    density: where there are how many scatterers per square metre of surface; a number for the same everywhere.
    region_m: box that the survey can see; scatterers lie inside it only.
    outer_rays: rays a pulse beside the scatterers.
    decorrelation_time_s: after which the field's correlation has fallen to 1 / e; None for a surface that stands still.
    caster: rays against the scene's surfaces; without it one is built.
    bounces: 2 to trace what places return by way of mirrors, too.
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
        caster: RayCaster | None = None,
        bounces: int = 1,
    ) -> None:
        check_sionna()
        self._sionna = sionna_scene(scene, antenna, chirp.carrier_hz, caster)
        self._density = density if isinstance(density, DensityMap) else DensityMap.constant(density)
        self._scatterers = Scatterers(scene, self._density, seed, region_m, caster)
        self._region_m, self._seed, self._outer_rays = region_m, seed, outer_rays
        self._wander_hz = 0.0 if decorrelation_time_s is None else wander_hz(decorrelation_time_s)
        self._mirrored = MirroredPlaces(scene, antenna, chirp, self._sionna.caster) if bounces > 1 else None
        self._look_through(antenna)

    def with_antenna(self, antenna: Antenna) -> "PersistentEngine":
        """Return the engine with another antenna, over the same scatterers."""
        other = copy(self)
        other._sionna = self._sionna.with_antenna(antenna)
        other._look_through(antenna)
        other._mirrored = None if self._mirrored is None else self._mirrored.with_antenna(antenna)
        return other

    def release_memory(self) -> None:
        """Give back the memory of the scatterers until more pulses are traced."""
        self._scatterers.release_memory()

    def _look_through(self, antenna: Antenna) -> None:
        self._beam = filled_beam(antenna)
        self._outer = OuterRays(antenna, self._beam, self._outer_rays, self._seed)

    def trace(self, pulses: Pulses) -> Paths:
        """Return the paths of a block of pulses, sorted by pulse: those of its scatterers, then of its other rays."""
        seen, visible, spans = self._seen(pulses)
        if len(seen) == 0:  # Dr.Jit does not accept empty arrays together with scalars
            return seen.paths(pulses, seen.factor, visible, spans)
        paths = seen.paths(pulses, _complex(self._fields(pulses, seen, visible)), visible, spans)
        if self._mirrored is None:
            return paths
        return Paths.concatenate([paths, self._mirrored.over(pulses, seen.only(visible))])

    def on_device(self, pulses: Pulses) -> Iterator[DevicePaths]:
        """Yield the paths of a block of pulses at once, without those that return by way of mirrors.

        Scatterers are searched on the host; their fields stay in the memory of the ray tracer.
        """
        seen, visible, spans = self._seen(pulses)
        field = self._fields(pulses, seen, visible)
        factor = mi.Complex2f(*(np.ascontiguousarray(part) for part in (seen.factor.real, seen.factor.imag)))
        yield DevicePaths(
            pulses=pulses,
            spans=tuple((bounds[:-1], bounds[1:]) for bounds in spans),
            delay_s=mi.Float64(seen.range_m * (2 / speed_of_light)),
            range_rate_mps=mi.Float(seen.range_rate_mps),
            gain=dr.select(mi.Bool(visible), field * factor, mi.Complex2f(0.0)),
            paths=seen.paths(pulses, _complex(field), visible, spans),
        )

    def _seen(
        self, pulses: Pulses
    ) -> tuple[SeenPlaces, Bool[np.ndarray, " place"], tuple[Int[np.ndarray, " edge"], Int[np.ndarray, " edge"]]]:
        """Return the places in the beams, which are visible, and where those of each pulse begin in each part."""
        spare = len(pulses) * self._outer.rays
        searched = beside(lambda: self._scatterers.in_beams(pulses, self._beam, self._wander_hz, spare))
        outside = self._outside(pulses)
        table, ends = searched()
        fixed = int(ends[-1])
        seen = table.continued(fixed, outside)
        visible = np.ones(len(seen), dtype=bool)
        apex, seen_from, place = pulses.true.position_m, seen.row[:fixed], seen.hit_m[:, :fixed].T
        visible[:fixed] = ~self._sionna.caster.hides(apex, seen_from, place, SHORT_OF_SURFACE)
        rows = fixed + np.searchsorted(outside.row, np.arange(len(pulses) + 1))
        return seen, visible, (ends, rows)

    def _outside(self, pulses: Pulses) -> SeenPlaces:
        """Return the surface places hit by the rays beside the scatterers."""
        pose, rays = pulses.true, self._outer.rays
        within, per_sr = self._outer.shoot(pulses.index)
        row = np.repeat(np.arange(len(pulses), dtype=np.uint32), rays)
        direction = np.einsum("nij,nj->ni", pose.R_world_antenna[row], within)
        hits = self._sionna.caster.cast(pose.position_m[row], direction)
        used = hits.hit & (per_sr > 0)
        distance = np.where(used, hits.distance_m, 0.0)
        place = pose.position_m[row] + distance[:, None] * direction
        used &= ~(self._beam.holds(within) & self._bears_scatterers(place))
        own, single = row[used], np.float32
        phase = pulse_uniforms(self._seed, Stream.SPECKLE, pulses.index, rays).ravel()[used]
        rate = -np.einsum("ni,ni->n", pose.velocity_mps[own], direction[used])
        return SeenPlaces(
            row=own,
            hit_m=place[used].T.astype(single),
            range_m=distance[used],
            range_rate_mps=rate.astype(single),
            cosine=hits.cosine[used].astype(single),
            solid_angle_sr=(1 / per_sr[used]).astype(single),
            surface=hits.surface[used].astype(np.int32),
            face=hits.face[used].astype(np.int32),
            factor=np.exp(2j * np.pi * phase).astype(np.complex64),
        )

    def _bears_scatterers(self, place_m: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        bears = self._density.at(place_m[:, :2]) > 0
        if self._region_m is not None:
            bears &= np.all((place_m >= self._region_m[0]) & (place_m <= self._region_m[1]), axis=1)
        return bears

    @flushed_denormals()
    def _fields(self, pulses: Pulses, seen: SeenPlaces, visible: Bool[np.ndarray, " place"]) -> Any:
        """Return the field from each visible place for a factor of one, in the memory of the ray tracer."""
        buffer = diffuse_buffer(
            mi.UInt32(seen.row),
            _points(seen.hit_m),
            mi.UInt32(self._sionna.shape_of_surface.astype(np.uint32)[seen.surface]),
            mi.UInt32(seen.face.view(np.uint32)),
            4 * dr.pi / dr.maximum(mi.Float(seen.solid_angle_sr), 1e-30),
            mi.Bool(visible),
        )
        apex, angles = pulses.true.position_m.T, sionna_angles(pulses.true.R_world_antenna).T
        gain = calculate_fields(self._sionna, buffer, _points(apex), _points(angles)).a[0][0]
        dr.eval(gain)
        return gain


def _complex(gain: Any) -> Complex[np.ndarray, " place"]:
    out = np.empty(dr.width(gain), dtype=np.complex64)
    out.real, out.imag = gain.real.numpy(), gain.imag.numpy()
    return out


def _points(columns: Float[np.ndarray, "3 n"]) -> Any:
    return mi.Point3f(*(np.ascontiguousarray(column, dtype=np.float32) for column in columns))
