"""The tracer of a radar: surfaces by an engine, plants, mirrors, point targets and the weather.

A steered tracer is that of an array whose beam is steered from pulse to pulse.
"""

from collections.abc import Sequence

import numpy as np

from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.progress import HoldsMemory
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scene.model import Scene
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.tracing.effects.atmosphere import Atmosphere
from sionna_radar.tracing.effects.canopy import Canopy
from sionna_radar.tracing.effects.dihedrals import DihedralTracer, dihedrals_of
from sionna_radar.tracing.effects.mirrors import MirrorTracer, plane_mirrors
from sionna_radar.tracing.effects.moving_ground import MovingGround
from sionna_radar.tracing.effects.targets import seen_past, trace_targets
from sionna_radar.tracing.paths import DeviceTracing, Engine, Paths


class Tracer:
    """An engine for the surfaces, with vegetation, mirror reflections, point targets, and the weather.

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
        self._hiding = [target for target in scene.targets if target.body is not None]
        self._bounces = bounces

    @property
    def device_engine(self) -> DeviceTracing | None:
        """The engine if its paths are all that there is and can stay in the memory of the ray tracer; else None."""
        weather = self._atmosphere is not None and not self._atmosphere.clear
        grown = self._moving is not None or self._canopy is not None
        alone = not (weather or grown or len(self._mirrors) or self._scene.targets)
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
        found = [self._tracers[int(pulses.beam[own[0]])].trace(pulses.rows(own)) for own in rows]
        paths = Paths.concatenate(found)
        return paths.rows(np.argsort(paths.pulse, kind="stable"))

    @property
    def device_engine(self) -> None:
        """No engine: the paths of several beams do not stay in the memory of the ray tracer."""
        return

    def release_memory(self) -> None:
        """Let the engines give back memory until more pulses are traced."""
        for tracer in self._tracers:
            tracer.release_memory()
