"""The persistent engine: scatterers fixed to the surface, so that phase from chirp to chirp is that of a real scene.

Each pulse sees the scatterers within its beam, truncated in azimuth and in elevation, that a ray reaches. Their fields
come from the same material, antenna and field calculator as the beam engine's: a scatterer of area A at range r and
incidence t represents the solid angle A cos t / r^2. Ranges, and with them phases, are float64.
"""

from copy import copy

import numpy as np
from jaxtyping import Complex, Float, Int

from sionna_radar.flight.pulses import Pulses
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.radar.main_lobe import reach_of_power
from sionna_radar.scene.model import Scene
from sionna_radar.tracing.engines.scatterers import scatter
from sionna_radar.tracing.paths import Paths
from sionna_radar.tracing.sionna.contract import check_sionna
from sionna_radar.tracing.sionna.fields import calculate_fields, diffuse_buffer
from sionna_radar.tracing.sionna.material import mi
from sionna_radar.tracing.sionna.pattern import sionna_angles
from sionna_radar.tracing.sionna.scene import SionnaScene

# isort: split
# Loads libLLVM, which the import above has selected.
import drjit as dr

# Share of the two-way power of each cut that may lie outside the beam.
OUTSIDE_SHARE = 1e-3
PULSES_AT_ONCE = 64
# A ray to a scatterer stops this far short of it, so that the scatterer's own triangle does not hide it.
SHORT_OF_SURFACE = 1e-4


class PersistentEngine:
    """Traces blocks of pulses over fixed scatterers; see the module docstring.

    per_m2: scatterers per square metre of surface.
    region_m: box that the survey can see; scatterers lie inside it only.
    """

    def __init__(
        self,
        scene: Scene,
        antenna: Antenna,
        chirp: Chirp,
        seed: int,
        per_m2: float,
        region_m: Float[np.ndarray, "2 3"] | None = None,
    ) -> None:
        check_sionna()
        self._sionna = SionnaScene(scene, antenna, chirp.carrier_hz)
        self._scatterers = scatter(scene, per_m2, seed, region_m)
        self._reach = reach_of_power(antenna, OUTSIDE_SHARE)
        self._position = mi.Point3f(self._scatterers.position_m.T.astype(np.float32))

    def with_antenna(self, antenna: Antenna) -> "PersistentEngine":
        """Return the engine with another antenna, over the same scatterers."""
        other = copy(self)
        other._sionna = self._sionna.with_antenna(antenna)
        other._reach = reach_of_power(antenna, OUTSIDE_SHARE)
        return other

    def trace(self, pulses: Pulses) -> Paths:
        """Return the paths of a block of pulses, sorted by pulse and then by scatterer."""
        chunks = np.array_split(np.arange(len(pulses)), -(-len(pulses) // PULSES_AT_ONCE))
        parts = [self._seen(pulses, rows) for rows in chunks]
        row, which = (np.concatenate(column) for column in zip(*parts, strict=True))
        return self._table(pulses, row, which)

    def _seen(
        self, pulses: Pulses, rows: Int[np.ndarray, " chunk"]
    ) -> tuple[Int[np.ndarray, " pair"], Int[np.ndarray, " pair"]]:
        """Return pulse row and scatterer of the pairs that lie in the beam and see each other."""
        pose = pulses.true
        beam, which = self._scatterers.cells.in_beams(pose.position_m[rows], pose.R_world_antenna[rows], self._reach)
        if len(beam) == 0:  # Dr.Jit does not accept empty arrays together with scalars
            return rows[beam], which
        origin = mi.Point3f(pose.position_m[rows[beam]].T.astype(np.float32))
        ahead, left, up = (mi.Vector3f(pose.R_world_antenna[rows[beam], :, i].T.astype(np.float32)) for i in range(3))
        away = dr.gather(mi.Point3f, self._position, mi.UInt32(which.astype(np.uint32))) - origin
        distance = dr.norm(away)
        azimuth, elevation = self._reach
        in_beam = dr.dot(away, ahead) > 0
        in_beam &= dr.abs(dr.dot(away, left)) <= azimuth * distance
        in_beam &= dr.abs(dr.dot(away, up)) <= elevation * distance
        ray = mi.Ray3f(origin, away / distance)
        ray.maxt = distance * (1 - SHORT_OF_SURFACE)
        seen = (in_beam & ~self._sionna.rt_scene.mi_scene.ray_test(ray, in_beam)).numpy()
        return rows[beam[seen]], which[seen]

    def _table(self, pulses: Pulses, row: Int[np.ndarray, " pair"], which: Int[np.ndarray, " pair"]) -> Paths:
        pose, points = pulses.true, self._scatterers
        away = points.position_m[which] - pose.position_m[row]
        range_m = np.linalg.norm(away, axis=1)
        direction = away / range_m[:, None]
        cos = np.abs(np.einsum("ni,ni->n", direction, points.normal[which]))
        solid_angle = points.area_m2 * cos / range_m**2
        gain = self._gains(pulses, row, which, 4 * np.pi / np.maximum(solid_angle, 1e-30))
        return Paths.to_points(
            pulses,
            row,
            points.position_m[which],
            gain=np.multiply(gain, points.reflectivity[which]),
            incidence_rad=np.arccos(np.minimum(cos, 1.0)),
            surface=points.surface[which],
        )

    def _gains(
        self,
        pulses: Pulses,
        row: Int[np.ndarray, " pair"],
        which: Int[np.ndarray, " pair"],
        probability: Float[np.ndarray, " pair"],
    ) -> Complex[np.ndarray, " pair"]:
        points = self._scatterers
        device_row, device_which = mi.UInt32(row.astype(np.uint32)), mi.UInt32(which.astype(np.uint32))
        if len(row) == 0:
            return np.zeros(0, dtype=np.complex64)
        shape = self._sionna.shape_of_surface[points.surface[which]].astype(np.uint32)
        buffer = diffuse_buffer(
            device_row,
            dr.gather(mi.Point3f, self._position, device_which),
            mi.UInt32(shape),
            mi.UInt32(points.face[which].astype(np.uint32)),
            mi.Float(probability.astype(np.float32)),
            dr.full(mi.Bool, True, len(row)),
        )
        origin = mi.Point3f(pulses.true.position_m.T.astype(np.float32))
        angles = mi.Point3f(sionna_angles(pulses.true.R_world_antenna).T.astype(np.float32))
        gain = calculate_fields(self._sionna, buffer, origin, angles).a[0][0]
        dr.eval(gain)
        return gain.real.numpy() + 1j * gain.imag.numpy()
