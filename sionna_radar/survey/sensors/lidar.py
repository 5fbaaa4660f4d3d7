"""The lidar sensor: a laser range finder on the radar's scan."""

import numpy as np
from scipy.constants import speed_of_light
from scipy.special import ndtri

from sionna_radar.detection.echoes import Echoes
from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.randomness import Stream, pulse_uniforms
from sionna_radar.foundation.stopwatch import timed
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.signal.build import lidar_receiver
from sionna_radar.signal.lidar import LidarReceiver
from sionna_radar.survey.sensors.lidar_as_built import LaserRanger, LidarAsBuilt, lidar_as_built
from sionna_radar.survey.sensors.sensor import Observation, SensorInputs
from sionna_radar.tracing.paths import VOLUME, Paths, trace_boresights


class Lidar(LaserRanger):
    """An ideal range sensor: the range along the beam axis with white noise, subject to attenuation in the air."""

    def __init__(
        self, caster: RayCaster, range_noise_m: float, seed: int, receiver: LidarReceiver | None = None
    ) -> None:
        self._caster, self._range_noise_m, self._seed = caster, range_noise_m, seed
        self._receiver = receiver

    def observe(self, pulses: Pulses) -> Observation:
        """Return the echoes of a block of pulses, of unit power and no noise."""
        with timed("trace"):
            paths = read = trace_boresights(pulses, self._caster)
        if self._receiver is not None:
            read = self._receiver.received(paths, pulses)
            # What the beam illuminates is not what the lidar detects of it.
            paths = Paths.concatenate([paths, read.rows(read.surface == VOLUME)])
        range_m = read.delay_s * speed_of_light / 2
        if self._range_noise_m:
            uniform = pulse_uniforms(self._seed, Stream.LIDAR, read.pulse, 1)[:, 0]
            range_m = range_m + self._range_noise_m * ndtri(np.maximum(uniform, 2.0**-54))
        echoes = Echoes(
            pulse=read.pulse,
            number=np.zeros(len(read), dtype=np.int64),
            range_m=range_m,
            range_sigma_m=np.full(len(read), self._range_noise_m),
            power=np.ones(len(read)),
            echo_snr_db=np.full(len(read), np.nan),
        )
        return Observation(paths=paths, echoes=echoes)


def lidar(inputs: SensorInputs) -> Lidar | LidarAsBuilt:
    """Return the lidar of a scenario."""
    if inputs.lidar.model == "as_built":
        return lidar_as_built(inputs)
    seed = inputs.engine.seed
    materials = [surface.material for surface in inputs.engine.scene.surfaces]
    receiver = lidar_receiver(inputs.lidar, inputs.weather, seed, materials)
    return Lidar(inputs.engine.caster, inputs.lidar.range_noise_m, seed, receiver)
