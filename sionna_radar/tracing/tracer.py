"""The tracer of a radar: surfaces by an engine, plants, mirrors, point targets, wires and the weather.

A steered tracer is that of an array whose beam is steered from pulse to pulse.

Surfaces moved by wind: phase, delay and range rate of each path, for any tracing engine.

Random motion is keyed by a scatterer's position, so it is the same in all pulses and blocks.
Where an engine draws new scatterers in each pulse, plants add no decorrelation; waves still move them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.constants import speed_of_light

from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.memory import HoldsMemory
from sionna_radar.foundation.randomness import Stream, place_uniforms
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scene.model import Scene
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.surfaces.motion import CALM_MPS, Waves, Windblown
from sionna_radar.tracing.effects.atmosphere import Atmosphere
from sionna_radar.tracing.effects.canopy import Canopy
from sionna_radar.tracing.effects.dihedrals import DihedralTracer, dihedrals_of
from sionna_radar.tracing.effects.mirrors import MirrorTracer, plane_mirrors
from sionna_radar.tracing.effects.targets import seen_past, trace_targets
from sionna_radar.tracing.effects.thin_cylinders import ThinTracer
from sionna_radar.tracing.paths import DeviceTracing, Engine, Paths


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
            on_surface = np.flatnonzero(paths.surface == surface)
            place, time_s = paths.hit_m[on_surface].astype(np.float64), pulses.time_s[row[on_surface]]
            away = place - pulses.true.position_m[row[on_surface]]
            sight = away / np.linalg.norm(away, axis=1)[:, None]
            offset, velocity = waves.moved(place, time_s)
            number = place_uniforms(self._seed, Stream.MOTION, place, 1)[:, 0]
            shift_hz = waves.ripple_hz(sight, number, self._wavelength_m)
            gain[on_surface] *= np.exp(2j * np.pi * np.mod(shift_hz * time_s, 1.0))
            delay_s[on_surface] += 2 / speed_of_light * np.einsum("ni,ni->n", offset, sight)
            rate_mps[on_surface] += np.einsum("ni,ni->n", velocity, sight) - shift_hz * self._wavelength_m / 2
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


class Tracer:
    """An engine for the surfaces, with vegetation, mirror reflections, point targets, wires, and the weather.

    Point targets preserve the polarization, like spheres and trihedral reflectors (an odd number of bounces): a
    cross-polar receiver does not see them, nor does a circular one of the same sense.

    atmosphere: None for clear air.
    moving: None where all surfaces stand still. canopy: None where nothing grows.
    seed: of the targets' fluctuations.
    bounces: 2 for the echoes of dihedrals, too; the engine adds those of a mirror and a diffuse surface.
    """

    def __init__(
        self,
        engine: Engine,
        scene: Scene,
        antenna: Antenna,
        chirp: Chirp,
        caster: RayCaster,
        *,
        atmosphere: Atmosphere | None = None,
        moving: MovingGround | None = None,
        canopy: Canopy | None = None,
        seed: int = 0,
        bounces: int = 1,
    ) -> None:
        self._engine, self._scene, self._antenna = engine, scene, antenna
        self._chirp, self._caster = chirp, caster
        self._atmosphere, self._moving, self._seed = atmosphere, moving, seed
        self._mirrors = MirrorTracer(scene, antenna, chirp, caster)
        corners = []
        if bounces > 1:
            corners = caster.once(
                "dihedrals", (scene, chirp.carrier_hz), lambda: dihedrals_of(plane_mirrors(scene, chirp))
            )
        self._dihedrals = DihedralTracer(corners, antenna, chirp, caster)
        self._canopy = canopy
        self._thin = ThinTracer(scene.thin, antenna, chirp, caster, first=len(scene.targets))
        self._hiding = [target for target in scene.targets if target.body is not None]
        self._bounces = bounces

    @property
    def device_engine(self) -> DeviceTracing | None:
        """The engine if its paths are all that there is and can stay in the memory of the ray tracer; else None."""
        weather = self._atmosphere is not None and not self._atmosphere.clear
        grown = self._moving is not None or self._canopy is not None
        alone = not (weather or grown or len(self._mirrors) or self._scene.targets or self._scene.thin)
        return self._engine if alone and self._bounces == 1 and isinstance(self._engine, DeviceTracing) else None

    def trace(self, pulses: Pulses) -> Paths:
        """Return the paths of a block of pulses."""
        paths = self._engine.trace(pulses)
        if self._moving is not None:
            paths = self._moving.moved(paths, pulses)
        if self._atmosphere is not None:
            paths = self._atmosphere.with_volume(paths, pulses)
        if self._canopy is not None:
            paths = self._canopy.over(paths, pulses)
        if len(self._mirrors):
            paths = Paths.concatenate([paths, self._among_plants(self._mirrors.trace(pulses), pulses)])
        if len(self._dihedrals):
            paths = Paths.concatenate([paths, self._dihedrals.trace(pulses)])
        if self._hiding:
            paths = seen_past(self._hiding, paths, pulses, self._chirp)
        if self._scene.targets and self._antenna.mirrored != 0:
            targets = trace_targets(self._scene.targets, pulses, self._antenna, self._chirp, self._caster, self._seed)
            paths = Paths.concatenate([paths, self._among_plants(targets, pulses)])
        if len(self._thin):
            paths = Paths.concatenate([paths, self._among_plants(self._thin.trace(pulses), pulses)])
        return paths if self._atmosphere is None else self._atmosphere.through(paths, pulses)

    def release_memory(self) -> None:
        """Let the engine give back memory until more pulses are traced."""
        if isinstance(self._engine, HoldsMemory):
            self._engine.release_memory()

    def _among_plants(self, paths: Paths, pulses: Pulses) -> Paths:
        return paths if self._canopy is None else self._canopy.through(paths, pulses)


class SteeredTracer:
    """A tracer for each beam of an electronic scan: each traces the pulses of its own."""

    def __init__(self, tracers: Sequence[Tracer]) -> None:
        self._tracers = tuple(tracers)

    def trace(self, pulses: Pulses) -> Paths:
        """Return the paths of a block of pulses, sorted by pulse."""
        assert pulses.beam is not None  # an electronic scan says the beam of every pulse
        rows = [np.flatnonzero(pulses.beam == beam) for beam in np.unique(pulses.beam)]
        traced = [
            self._tracers[int(pulses.beam[rows_of_beam[0]])].trace(pulses.rows(rows_of_beam)) for rows_of_beam in rows
        ]
        return Paths.concatenate(traced)

    @property
    def device_engine(self) -> None:
        """No engine: the paths of several beams do not stay in the memory of the ray tracer."""
        return

    def release_memory(self) -> None:
        """Let the engines give back memory until more pulses are traced."""
        for tracer in self._tracers:
            tracer.release_memory()
