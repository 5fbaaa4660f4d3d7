"""The beam engine: rays of a block of pulses in one wavefront, fields by Sionna RT's field calculator.

Rays are shot only inside the beam (see `rays`). One of K rays drawn with the density p per steradian
represents the solid angle 1 / (K p): Sionna's field calculator starts from 4 pi / samples and divides by the
probability stored with the path, so samples = 1 and probability = 4 pi K p express this. A monostatic echo
returns along the same ray, so no second visibility test is needed.
"""

from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.randomness import Stream, pulse_uniforms
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.raytracer.backend import aligned, flushed_denormals
from sionna_radar.scene.model import Scene
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.tracing.engines.beam.rays import CutRays, GridRays, beam_rays, beam_sampler
from sionna_radar.tracing.engines.persistent.mirrored_places import MirroredPlaces
from sionna_radar.tracing.engines.persistent.seen_places import SeenPlaces
from sionna_radar.tracing.paths import DevicePaths, Paths
from sionna_radar.tracing.sionna.contract import check_sionna
from sionna_radar.tracing.sionna.fields import calculate_fields, diffuse_buffer
from sionna_radar.tracing.sionna.material import mi
from sionna_radar.tracing.sionna.pattern import sionna_angles
from sionna_radar.tracing.sionna.scene import sionna_scene

# isort: split
# Loads libLLVM, which an import above has selected.
import drjit as dr

RAYS_AT_ONCE = 4_000_000


@dataclass(frozen=True, kw_only=True)
class _Columns:
    """The paths of a wavefront in the memory of the ray tracer, sorted by pulse; shape: its pointer as an integer."""

    row: Any
    gain: Any
    delay_s: Any
    range_rate_mps: Any
    incidence_rad: Any
    hit_m: tuple[Any, Any, Any]
    shape: Any


@dataclass(frozen=True, kw_only=True)
class RayHits:
    """Where the rays of a block meet the scene, in the memory of the ray tracer; undefined where not `valid`.

    row: pulse of each ray in its block; shape: its pointer as an integer, and the triangle `face` of it.
    probability: 4 pi over the solid angle that a ray represents.
    """

    row: Any
    place: Any
    normal: Any
    shape: Any
    face: Any
    probability: Any
    valid: Any


class BeamEngine:
    """Traces blocks of pulses; see the module docstring.

    caster: rays against the scene's surfaces; without it one is built.
    bounces: 2 to trace what places return by way of mirrors, too.
    """

    def __init__(
        self,
        scene: Scene,
        antenna: Antenna,
        chirp: Chirp,
        seed: int,
        paths_per_pulse: int,
        side_lobe_share: float,
        caster: RayCaster | None = None,
        bounces: int = 1,
    ) -> None:
        check_sionna()
        self.sionna = sionna_scene(scene, antenna, chirp.carrier_hz, caster)
        self._sampler = beam_sampler(paths_per_pulse, side_lobe_share)
        self._rays = beam_rays(antenna)
        self.seed = seed
        self._mirrored = MirroredPlaces(scene, antenna, chirp, self.sionna.caster) if bounces > 1 else None
        self._unit = [mi.Float(column.astype(np.float32)) for column in self._sampler.unit.T]
        self._draw, self._opposite = 0, False

    def with_rays(self, rays: CutRays | GridRays, draw: int, *, opposite: bool) -> "BeamEngine":
        """Return the engine with other rays: the number of their random shift, and whether on the axis's other side."""
        other = copy(self)
        other._rays = rays
        other._draw, other._opposite = draw, opposite
        return other

    def with_antenna(self, antenna: Antenna) -> "BeamEngine":
        """Return the engine with another antenna, over the same scene."""
        other = copy(self)
        other.sionna = self.sionna.with_antenna(antenna)
        other._rays = beam_rays(antenna)
        other._mirrored = None if self._mirrored is None else self._mirrored.with_antenna(antenna)
        return other

    def trace(self, pulses: Pulses) -> Paths:
        """Return the paths of a block of pulses, traced in wavefronts of at most `RAYS_AT_ONCE` rays."""
        wavefronts = []
        for pulses_of_wavefront in self._wavefronts(pulses):
            columns, places = self._traced(pulses_of_wavefront)
            wavefronts.append(self._table(pulses_of_wavefront, columns))
            if self._mirrored is not None and places is not None:
                wavefronts.append(self._mirrored.over(pulses_of_wavefront, places))
        return wavefronts[0] if len(wavefronts) == 1 else Paths.concatenate(wavefronts)

    def on_device(self, pulses: Pulses) -> Iterator[DevicePaths]:
        """Yield the paths of each wavefront, without those that return by way of mirrors."""
        for pulses_of_wavefront in self._wavefronts(pulses):
            columns, _ = self._traced(pulses_of_wavefront)
            bounds = np.searchsorted(columns.row.numpy(), np.arange(len(pulses_of_wavefront) + 1))
            yield DevicePaths(
                pulses=pulses_of_wavefront,
                spans=((bounds[:-1], bounds[1:]),),
                delay_s=mi.Float64(columns.delay_s),
                range_rate_mps=columns.range_rate_mps,
                gain=columns.gain,
                paths=self._table(pulses_of_wavefront, columns),
            )

    def _wavefronts(self, pulses: Pulses) -> Iterator[Pulses]:
        step = max(1, RAYS_AT_ONCE // self._sampler.rays)
        for start in range(0, len(pulses), step):
            yield pulses if len(pulses) <= step else pulses.rows(slice(start, start + step))

    @flushed_denormals()
    def _traced(self, pulses: Pulses) -> tuple[_Columns, SeenPlaces | None]:
        """Return the paths of a wavefront, and where its rays end if mirrors see that."""
        pose = pulses.true
        origin = point_of(pose.position_m)
        angles = point_of(sionna_angles(pose.R_world_antenna))
        row, direction, probability = self._shoot(pulses)
        hit = self._intersect(origin, row, direction)
        incidence = dr.safe_acos(dr.abs(dr.dot(hit.n, direction)))
        rate = -dr.dot(dr.gather(mi.Vector3f, vector_of(pose.velocity_mps), row), direction)
        shape = self.sionna.shape_of_hit(hit)
        valid = hit.is_valid() & (probability > 0)
        buffer = diffuse_buffer(row, hit.p, shape, hit.prim_index, probability, valid)
        dr.schedule(incidence, rate)
        buffer = calculate_fields(self.sionna, buffer, origin, angles)
        columns = self._columns(pulses, buffer, incidence, rate)
        if self._mirrored is None:
            return columns, None
        return columns, self._places(pulses, row, hit, shape, probability, rate).only(valid.numpy())

    def cast(self, pulses: Pulses) -> RayHits:
        """Return the hits of a block's rays on the scene."""
        row, direction, probability = self._shoot(pulses)
        hit = self._intersect(point_of(pulses.true.position_m), row, direction)
        hits = RayHits(
            row=row,
            place=hit.p,
            normal=mi.Vector3f(hit.n),
            shape=self.sionna.shape_of_hit(hit),
            face=hit.prim_index,
            probability=probability,
            valid=hit.is_valid() & (probability > 0),
        )
        dr.eval(hits.row, hits.place, hits.normal, hits.shape, hits.face, hits.probability, hits.valid)
        return hits

    def _intersect(self, origin: Any, row: Any, direction: Any) -> Any:
        return self.sionna.caster.mi_scene.ray_intersect(mi.Ray3f(dr.gather(mi.Point3f, origin, row), direction))

    def _places(self, pulses: Pulses, row, hit, shape, probability, rate) -> SeenPlaces:  # type: ignore[no-untyped-def]
        """Return the surface places hit by rays, the input of mirrors; undefined for rays that meet nothing."""
        phase = pulse_uniforms(self.seed, Stream.SPECKLE, pulses.index, self._sampler.rays).ravel()
        dr.eval(row, hit.t, hit.n, hit.p, hit.prim_index, shape, probability, rate)
        normal = hit.n.numpy()
        place = hit.p.numpy()
        away = place - pulses.true.position_m.T[:, row.numpy()]
        range_m = np.linalg.norm(away, axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            solid_angle = 4 * np.pi / probability.numpy()
            cosine = np.abs(np.einsum("in,in->n", away, normal)) / range_m
        return SeenPlaces(
            row=row.numpy(),
            hit_m=place,
            range_m=range_m,
            range_rate_mps=rate.numpy(),
            cosine=cosine,
            solid_angle_sr=solid_angle,
            surface=self.sionna.surface_of_shape[shape.numpy()],
            face=hit.prim_index.numpy().astype(np.int64),
            factor=np.exp(2j * np.pi * phase).astype(np.complex64),
        )

    def _shoot(self, pulses: Pulses):  # type: ignore[no-untyped-def]
        """Return each ray's row in the block, its direction, and 4 pi K p."""
        sampler = self._sampler
        shift = pulse_uniforms(self.seed, Stream.DIRECTIONS, pulses.index, 2 * (self._draw + 1))[:, -2:]
        ray = dr.arange(mi.UInt32, len(pulses) * sampler.rays)
        row = ray // sampler.rays
        ray -= row * sampler.rays
        unit = []
        for column, lattice in enumerate(self._unit):
            moved = dr.gather(mi.Float, lattice, ray)
            moved += dr.gather(mi.Float, mi.Float(aligned(shift[:, column])), row)
            moved -= dr.floor(moved)
            unit.append(1 - moved if self._opposite else moved)
        in_beam = ray < sampler.beam_rays
        (ahead, left, up), density, valid = self._rays.shoot(unit, in_beam, sampler.beam_fraction)
        probability = dr.select(valid, 4 * dr.pi * sampler.rays * density, 0.0)
        axes = [dr.gather(mi.Vector3f, vector_of(pulses.true.R_world_antenna[:, :, axis]), row) for axis in range(3)]
        return row, dr.normalize(axes[0] * ahead + axes[1] * left + axes[2] * up), probability

    def _columns(self, pulses: Pulses, buffer, incidence, rate) -> _Columns:  # type: ignore[no-untyped-def]
        phase = pulse_uniforms(self.seed, Stream.SPECKLE, pulses.index, self._sampler.rays)
        gain = buffer.a[0][0] * dr.exp(mi.Complex2f(0, 2 * dr.pi * mi.Float(aligned(phase.ravel()))))
        dr.eval(buffer.valid, gain, buffer.tau)
        keep = dr.compress(buffer.valid)
        row, gain, tau, incidence, rate, x, y, z, shape = (
            dr.gather(type(column), column, keep)
            for column in (
                buffer.source_indices,
                gain,
                buffer.tau,
                incidence,
                rate,
                buffer.vertices_x.array,
                buffer.vertices_y.array,
                buffer.vertices_z.array,
                buffer.shapes.array,
            )
        )
        dr.eval(row, gain, tau, incidence, rate, x, y, z, shape)
        return _Columns(
            row=row,
            gain=gain,
            delay_s=tau,
            range_rate_mps=rate,
            incidence_rad=incidence,
            hit_m=(x, y, z),
            shape=shape,
        )

    def _table(self, pulses: Pulses, columns: _Columns) -> Paths:
        gain = np.empty(dr.width(columns.row), dtype=np.complex64)
        gain.real, gain.imag = columns.gain.real.numpy(), columns.gain.imag.numpy()
        return Paths(
            pulse=pulses.index[columns.row.numpy()],
            delay_s=columns.delay_s.numpy().astype(np.float64),
            gain=gain,
            range_rate_mps=columns.range_rate_mps.numpy(),
            incidence_rad=columns.incidence_rad.numpy(),
            hit_m=np.column_stack([axis.numpy() for axis in columns.hit_m]),
            surface=self.sionna.surface_of_shape[columns.shape.numpy()],
        )


def point_of(array: Float[np.ndarray, "n 3"]) -> Any:
    """Return points on the device."""
    return mi.Point3f(*map(aligned, array.T))


def vector_of(array: Float[np.ndarray, "n 3"]) -> Any:
    """Return vectors on the device."""
    return mi.Vector3f(*map(aligned, array.T))
