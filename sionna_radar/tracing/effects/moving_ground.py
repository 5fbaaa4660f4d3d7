"""Surfaces moved by wind: phase, delay and range rate of each path, for any tracing engine.

Random motion is keyed by a scatterer's position, so it is the same in all pulses and blocks.
Where an engine draws new scatterers in each pulse, plants add no decorrelation; waves still move them.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.constants import speed_of_light

from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.randomness import Stream, place_uniforms
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scene.model import Scene
from sionna_radar.surfaces.motion import CALM_MPS, Waves, Windblown
from sionna_radar.tracing.paths import Paths


class MovingGround:
    """The surfaces of a scene that move.

    _plants: mask of surfaces with plants. _waves: waves by surface number.
    """

    def __init__(self, scene: Scene, wind_mps: Float[np.ndarray, " 3"], chirp: Chirp, seed: int) -> None:
        motion = [scene.motions.get(surface.material) for surface in scene.surfaces]
        self._plants = np.array([one is not None and one.kind == "plants" for one in motion])
        self._waves: Mapping[int, Waves] = {
            number: Waves.of(wind_mps[:2], one.fetch_m, seed)
            for number, one in enumerate(motion)
            if one is not None and one.kind == "water"
        }
        self._windblown = Windblown.of(float(np.linalg.norm(wind_mps[:2])), chirp.carrier_hz)
        self._wavelength_m, self._seed = chirp.wavelength_m, seed

    def moved(self, paths: Paths, pulses: Pulses) -> Paths:
        """Return paths with phase, delay and range rate due to wind."""
        gain, delay_s, rate_mps = paths.gain.copy(), paths.delay_s.copy(), paths.range_rate_mps.copy()
        row = pulses.row_of(paths.pulse)
        of_plants = np.flatnonzero((paths.surface >= 0) & self._plants[np.maximum(paths.surface, 0)])
        number = place_uniforms(self._seed, Stream.MOTION, paths.hit_m[of_plants], 2)
        shift_hz = self._windblown.shift_hz(number)
        gain[of_plants] *= np.exp(2j * np.pi * np.mod(shift_hz * pulses.time_s[row[of_plants]], 1.0))
        rate_mps[of_plants] -= shift_hz * self._wavelength_m / 2
        for surface, waves in self._waves.items():
            own = np.flatnonzero(paths.surface == surface)
            place, time_s = paths.hit_m[own].astype(np.float64), pulses.time_s[row[own]]
            away = place - pulses.true.position_m[row[own]]
            sight = away / np.linalg.norm(away, axis=1)[:, None]
            offset, velocity = waves.moved(place, time_s)
            number = place_uniforms(self._seed, Stream.MOTION, place, 1)[:, 0]
            shift_hz = waves.ripple_hz(sight, number, self._wavelength_m)
            gain[own] *= np.exp(2j * np.pi * np.mod(shift_hz * time_s, 1.0))
            delay_s[own] += 2 / speed_of_light * np.einsum("ni,ni->n", offset, sight)
            rate_mps[own] += np.einsum("ni,ni->n", velocity, sight) - shift_hz * self._wavelength_m / 2
        return replace(paths, gain=gain, delay_s=delay_s, range_rate_mps=rate_mps)


def build_moving_ground(
    scene: Scene, wind_mps: Float[np.ndarray, " 3"], chirp: Chirp, seed: int
) -> MovingGround | None:
    """Return the motion of a scene's surfaces; None if calm or all static."""
    if float(np.linalg.norm(wind_mps[:2])) < CALM_MPS:
        return None
    if not any(surface.material in scene.motions for surface in scene.surfaces):
        return None
    return MovingGround(scene, wind_mps, chirp, seed)
