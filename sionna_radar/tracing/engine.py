"""What every tracing engine offers, and which one a scenario asks for."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from sionna_radar.flight.pulses import Pulses
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scenario.tracing import TracingTable
from sionna_radar.scene.model import Scene
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.tracing.effects.atmosphere import Atmosphere
from sionna_radar.tracing.effects.mirrors import MirrorTracer
from sionna_radar.tracing.effects.targets import trace_targets
from sionna_radar.tracing.paths import Paths


@runtime_checkable
class Engine(Protocol):
    """Traces the surfaces of a scene."""

    def trace(self, pulses: Pulses) -> Paths:
        """Return the paths of a block of pulses."""
        ...


class Tracer:
    """An engine for the surfaces, their mirror reflections, the point targets, and the weather before all.

    Point targets keep the polarisation, as spheres and trihedral reflectors do (an odd number of bounces): a
    cross-polar receiver does not see them, nor does a circular one of the same sense.

    atmosphere: None for clear air.
    seed: of the targets' fluctuations.
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
        seed: int = 0,
    ) -> None:
        self._engine, self._scene, self._antenna = engine, scene, antenna
        self._chirp, self._caster = chirp, caster
        self._atmosphere, self._seed = atmosphere, seed
        self._mirrors = MirrorTracer(scene, antenna, chirp, caster)

    def trace(self, pulses: Pulses) -> Paths:
        """Return the paths of a block of pulses."""
        paths = self._engine.trace(pulses)
        if self._atmosphere is not None:
            paths = self._atmosphere.with_volume(paths, pulses)
        if len(self._mirrors):
            paths = Paths.concatenate([paths, self._mirrors.trace(pulses)])
        if self._scene.targets and self._antenna.mirrored != 0:
            targets = trace_targets(self._scene.targets, pulses, self._antenna, self._chirp, self._caster, self._seed)
            paths = Paths.concatenate([paths, targets])
        return paths if self._atmosphere is None else self._atmosphere.through(paths, pulses)


@dataclass(frozen=True, kw_only=True)
class EngineInputs:
    """What an engine is made from.

    caster: rays against the scene's surfaces, for engines that do not trace fields themselves.
    region_m: lowest and highest corner of the box that the survey can see.
    """

    scene: Scene
    antenna: Antenna
    chirp: Chirp
    seed: int
    caster: RayCaster
    region_m: Float[np.ndarray, "2 3"]


def build_engine(table: TracingTable, given: EngineInputs) -> Engine:
    """Return the engine that a scenario names."""
    scene, antenna, chirp, seed = given.scene, given.antenna, given.chirp, given.seed
    if table.engine == "gamma":
        from sionna_radar.tracing.engines.facets import GammaEngine

        return GammaEngine(scene, antenna, chirp, seed, given.caster, speckle=table.speckle)
    if table.engine == "path_solver":
        from sionna_radar.tracing.engines.stock import PathSolverEngine

        return PathSolverEngine(scene, antenna, chirp, seed, samples=table.paths_per_pulse)
    if table.speckle == "persistent":
        from sionna_radar.tracing.engines.persistent import PersistentEngine

        return PersistentEngine(scene, antenna, chirp, seed, table.scatterers_per_m2, given.region_m)
    from sionna_radar.tracing.engines.beam import BeamEngine

    return BeamEngine(scene, antenna, chirp, seed, table.paths_per_pulse, table.side_lobe_share)
