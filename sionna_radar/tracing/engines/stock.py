"""The path_solver engine: Sionna RT's stock PathSolver, pulse by pulse, with the same material and antenna; slow.

It shoots its rays over the whole sphere, so a pencil beam gets few of them; its use is to check the beam engine.
"""

import numpy as np
from jaxtyping import Float, UInt32

from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.randomness import Stream, pulse_generator
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.raytracer.backend import flushed_denormals
from sionna_radar.scene.model import Scene
from sionna_radar.tracing.paths import Paths
from sionna_radar.tracing.sionna.material import mi
from sionna_radar.tracing.sionna.pattern import sionna_angles
from sionna_radar.tracing.sionna.scene import SionnaScene

# isort: split
# These load libLLVM, which the import above has selected.
import drjit as dr
import sionna.rt as rt


class PathSolverEngine:
    """Traces one pulse after another with `sionna.rt.PathSolver`.

    samples: rays per pulse, over the whole sphere.
    """

    @flushed_denormals()
    def __init__(self, scene: Scene, antenna: Antenna, chirp: Chirp, seed: int, samples: int) -> None:
        self._sionna = SionnaScene(scene, antenna, chirp.carrier_hz)
        self._seed, self._samples = seed, samples
        sender, receiver = (
            rt.AntennaArray(pattern, mi.Point3f(0.0, 0.0, 0.0))
            for pattern in (self._sionna.pattern, self._sionna.receive_pattern)
        )
        self._sionna.rt_scene.tx_array, self._sionna.rt_scene.rx_array = sender, receiver
        self._devices = [rt.Transmitter("sender", [0.0, 0.0, 0.0]), rt.Receiver("receiver", [0.0, 0.0, 0.0])]
        for device in self._devices:
            self._sionna.rt_scene.add(device)
        self._solver = rt.PathSolver(deterministic=True)

    def trace(self, pulses: Pulses) -> Paths:
        """Return the paths of a block of pulses."""
        return Paths.concatenate([self._one(pulses, row) for row in range(len(pulses))])

    @flushed_denormals()
    def _one(self, pulses: Pulses, row: int) -> Paths:
        pose, index = pulses.true, int(pulses.index[row])
        angles = sionna_angles(pose.R_world_antenna[row : row + 1])[0]
        for device in self._devices:
            device.position = mi.Point3f(*pose.position_m[row].tolist())
            device.orientation = mi.Point3f(*angles.tolist())
        paths = self._solver(
            self._sionna.rt_scene,
            max_depth=1,
            samples_per_src=self._samples,
            max_num_paths_per_src=self._samples,
            los=False,
            specular_reflection=False,
            diffuse_reflection=True,
            refraction=False,
            seed=(self._seed + index) % 2**31,
        )
        # Padding, if there is any, has a negative delay. Threads find the paths in an order that differs each time.
        delay_s, vertices = paths.tau.numpy().ravel(), np.moveaxis(paths.vertices.numpy(), -1, 0)
        order = np.lexsort([column.ravel() for column in vertices])
        real = order[delay_s[order] >= 0]
        gain = (paths.a[0].numpy() + 1j * paths.a[1].numpy()).ravel()[real]
        hit = np.stack([column.ravel()[real] for column in vertices], axis=1)
        shape = paths.objects.numpy().ravel()[real]
        primitive = paths.primitives.numpy().ravel()[real]
        direction = hit - pose.position_m[row]
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        phase = 2 * np.pi * pulse_generator(self._seed, Stream.SPECKLE, index).random(len(gain))
        normal = self._normals(shape, primitive)
        return Paths.to_points(
            pulses,
            np.full(len(gain), row),
            hit.astype(np.float64),
            gain=(gain * np.exp(1j * phase)).astype(np.complex64),
            incidence_rad=np.arccos(np.clip(np.abs(np.sum(normal * direction, axis=1)), 0.0, 1.0)),
            surface=self._sionna.surface_of_shape[shape],
        )

    def _normals(
        self, shape: UInt32[np.ndarray, " path"], primitive: UInt32[np.ndarray, " path"]
    ) -> Float[np.ndarray, "path 3"]:
        mesh = dr.reinterpret_array(mi.MeshPtr, mi.UInt32(shape))
        return np.asarray(mesh.face_normal(mi.UInt32(primitive)).numpy()).T
