"""The persistent engine: tracing of scatterers fixed to the surface, coherent from chirp to chirp.

Each pulse sees the scatterers within its beam, truncated in azimuth and in elevation, that a ray reaches. Their fields
come from the same material, antenna and field calculator as the beam engine's: a scatterer of area A at range r and
incidence t represents the solid angle A cos t / r^2. Ranges, and with them phases, are float64.

What the scatterers leave out, some thousandths of the echo, is traced by a few rays that are drawn anew in each pulse
(`OuterRays`): the skirts and side lobes of the beam carry their power, but no history of phase. Half of these rays
follow the antenna's two-way power outside the part of the beam that scatterers fill, the others are spread evenly.

On a surface that moves each scatterer has a Doppler shift of its own; see `tracing.paths`.
"""

from collections.abc import Iterator
from copy import copy
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Bool, Complex, Float, Int
from scipy.constants import speed_of_light

from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.randomness import Stream, pulse_uniforms
from sionna_radar.foundation.sequences import halton
from sionna_radar.foundation.threads import in_background
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.radar.two_way_grid import TwoWayGrid, toward
from sionna_radar.raytracer.backend import aligned, flushed_denormals
from sionna_radar.scene.model import Scene
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.tracing.engines.persistent.density import DensityMap, FilledBeam, filled_beam, power_grid
from sionna_radar.tracing.engines.persistent.mirrored_places import MirroredPlaces
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

FOLLOWING = 0.5


class OuterRays:
    """Draws directions outside a part of a beam, and few inside.

    antenna: whose power they follow.
    filled: the part of the beam to be left out.
    rays: how many a pulse.
    seed: of the directions.
    """

    def __init__(self, antenna: Antenna, filled: FilledBeam, rays: int, seed: int) -> None:
        self._grid = power_grid(antenna)
        self._power, self._below = _outside(antenna, filled)
        self._ahead = antenna.separable
        following = round(rays * FOLLOWING) if self._below[-1] > 0 else 0
        self.rays, self._share, self._seed = rays, following / rays, seed
        self._unit = np.concatenate([halton(following), halton(rays - following)])
        self._following = following

    def shoot(self, pulse: Int[np.ndarray, " pulse"]) -> tuple[Float[np.ndarray, "ray 3"], Float[np.ndarray, " ray"]]:
        """Return unit vectors in the antenna's frame, pulse by pulse, and how many rays there are per steradian.

        The density is zero where a ray must not be used.
        """
        shift = pulse_uniforms(self._seed, Stream.DIRECTIONS, pulse, 2)
        unit = np.mod(self._unit[None] + shift[:, None], 1.0)
        along, anywhere = (part.reshape(-1, 2) for part in np.split(unit, [self._following], axis=1))
        drawn = self._along_power(along), self._anywhere(anywhere)
        direction = np.concatenate([part.reshape(len(pulse), -1, 3) for part in drawn], axis=1).reshape(-1, 3)
        return direction, self.rays * self._density(direction)

    def _along_power(self, unit: Float[np.ndarray, "ray 2"]) -> Float[np.ndarray, "ray 3"]:
        grid = self._grid
        columns = len(grid.left) - 1
        cell = np.minimum(np.searchsorted(self._below, unit[:, 0] * self._below[-1]), len(self._below) - 1)
        power = self._power.ravel()[cell]
        fraction = np.clip((unit[:, 0] - (self._below[cell] - power)) / np.maximum(power, 1e-300), 0.0, 1.0)
        row, column = np.divmod(cell, columns)
        u = grid.left[column] + fraction * (grid.left[column + 1] - grid.left[column])
        v = grid.up[row] + unit[:, 1] * (grid.up[row + 1] - grid.up[row])
        cos2 = 1 - u**2 - v**2
        face = np.column_stack([np.sqrt(np.maximum(cos2, 0.0)), u, v])
        # Beyond the half sphere there is nothing: such a ray has no density, below, as its length is not one.
        return face @ grid.R_face_antenna

    def _anywhere(self, unit: Float[np.ndarray, "ray 2"]) -> Float[np.ndarray, "ray 3"]:
        ahead = unit[:, 0] if self._ahead else 2 * unit[:, 0] - 1
        sine, turn = np.sqrt(np.maximum(1 - ahead**2, 0.0)), 2 * np.pi * unit[:, 1]
        return np.column_stack([ahead, sine * np.cos(turn), sine * np.sin(turn)])

    def _density(self, direction: Float[np.ndarray, "ray 3"]) -> Float[np.ndarray, " ray"]:
        grid = self._grid
        normal, u, v = (direction @ grid.R_face_antenna.T).T
        column = np.clip(np.searchsorted(grid.left, u, side="right") - 1, 0, len(grid.left) - 2)
        row = np.clip(np.searchsorted(grid.up, v, side="right") - 1, 0, len(grid.up) - 2)
        area = (grid.left[column + 1] - grid.left[column]) * (grid.up[row + 1] - grid.up[row])
        following = np.where(normal > 0, normal * self._power[row, column] / np.maximum(area, 1e-20), 0.0)
        anywhere = np.where(direction[:, 0] > 0, 1 / (2 * np.pi), 0.0) if self._ahead else 1 / (4 * np.pi)
        whole = np.abs(np.einsum("ni,ni->n", direction, direction) - 1) < 1e-6
        return np.where(whole, self._share * following + (1 - self._share) * anywhere, 0.0)


@lru_cache(maxsize=2)
def _outside(
    antenna: Antenna, filled: FilledBeam
) -> tuple[Float[np.ndarray, "row column"], Float[np.ndarray, " cell"]]:
    """Return each cell's share of the power outside a part of a beam, and the sums of those up to each."""
    grid = power_grid(antenna)
    power = np.where(_within(grid, filled), 0.0, grid.power_sr)
    power /= max(power.sum(), 1e-300)
    return power, np.cumsum(power.ravel())


def _within(grid: TwoWayGrid, filled: FilledBeam) -> Bool[np.ndarray, "row column"]:
    """Return True where cells lie wholly in the part of the beam that is left out."""
    u, v = np.meshgrid(grid.left, grid.up)
    inside = filled.holds(toward(u.ravel(), v.ravel()) @ grid.R_face_antenna).reshape(u.shape)
    return inside[1:, 1:] & inside[1:, :-1] & inside[:-1, 1:] & inside[:-1, :-1]


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
        seen, spans = self._seen(pulses)
        if len(seen) == 0:  # Dr.Jit does not accept empty arrays together with scalars
            return seen.paths(pulses, seen.factor, spans)
        paths = seen.paths(pulses, _complex(self._fields(pulses, seen)), spans)
        if self._mirrored is None:
            return paths
        return Paths.concatenate([paths, self._mirrored.over(pulses, seen)])

    def on_device(self, pulses: Pulses) -> Iterator[DevicePaths]:
        """Yield the paths of a block of pulses at once, without those that return by way of mirrors.

        Scatterers are searched on the host; their fields stay in the memory of the ray tracer.
        """
        seen, spans = self._seen(pulses)
        field = self._fields(pulses, seen)
        factor = mi.Complex2f(aligned(seen.factor.real), aligned(seen.factor.imag))
        yield DevicePaths(
            pulses=pulses,
            spans=tuple((bounds[:-1], bounds[1:]) for bounds in spans),
            delay_s=mi.Float64(seen.range_m * (2 / speed_of_light)),
            range_rate_mps=mi.Float(seen.range_rate_mps),
            gain=field * factor,
            paths=seen.paths(pulses, _complex(field), spans),
        )

    def _seen(self, pulses: Pulses) -> tuple[SeenPlaces, tuple[Int[np.ndarray, " edge"], Int[np.ndarray, " edge"]]]:
        """Return the visible places in the beams, and where those of each pulse begin in each of two parts."""
        spare = len(pulses) * self._outer.rays
        searched = in_background(lambda: self._scatterers.in_beams(pulses, self._beam, self._wander_hz, spare))
        outside = self._outside(pulses)
        table, ends = searched()
        scatterers = table.first(int(ends[-1]))
        hidden = self._sionna.caster.hides(pulses.true.position_m, scatterers.row, scatterers.hit_m.T, SHORT_OF_SURFACE)
        if hidden.any():
            scatterers.keep(np.flatnonzero(~hidden))
            ends = np.concatenate([[0], np.cumsum(~hidden)])[ends]
        seen = table.continued(int(ends[-1]), outside)
        return seen, (ends, ends[-1] + np.searchsorted(outside.row, np.arange(len(pulses) + 1)))

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
        pulse_row, single = row[used], np.float32
        phase = pulse_uniforms(self._seed, Stream.SPECKLE, pulses.index, rays).ravel()[used]
        rate = -np.einsum("ni,ni->n", pose.velocity_mps[pulse_row], direction[used])
        return SeenPlaces(
            row=pulse_row,
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
    def _fields(self, pulses: Pulses, seen: SeenPlaces) -> Any:
        """Return the field from each place for a factor of one, in the memory of the ray tracer."""
        buffer = diffuse_buffer(
            mi.UInt32(aligned(seen.row, np.uint32)),
            _points(seen.hit_m),
            mi.UInt32(aligned(self._sionna.shape_of_surface[seen.surface], np.uint32)),
            mi.UInt32(aligned(seen.face, np.uint32)),
            4 * dr.pi / dr.maximum(mi.Float(aligned(seen.solid_angle_sr)), 1e-30),
            dr.full(mi.Bool, True, len(seen)),
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
    return mi.Point3f(*map(aligned, columns))
