"""What every tracing engine offers, and which one a scenario asks for."""

from typing import Protocol, runtime_checkable

from sionna_radar.flight.pulses import Pulses
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scenario.models import TracingTable
from sionna_radar.scene.model import Scene
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.tracing.paths import Paths
from sionna_radar.tracing.targets import trace_targets


@runtime_checkable
class Engine(Protocol):
    """Traces the surfaces of a scene."""

    def trace(self, pulses: Pulses) -> Paths:
        """Return the paths of a block of pulses."""
        ...


class Tracer:
    """An engine for the surfaces, and the point targets beside it."""

    def __init__(
        self, engine: Engine, scene: Scene, antenna: Antenna, chirp: Chirp, caster: RayCaster
    ) -> None:
        self._engine, self._scene, self._antenna = engine, scene, antenna
        self._chirp, self._caster = chirp, caster

    def trace(self, pulses: Pulses) -> Paths:
        """Return the paths of a block of pulses."""
        paths = self._engine.trace(pulses)
        if not self._scene.targets:
            return paths
        targets = trace_targets(self._scene.targets, pulses, self._antenna, self._chirp, self._caster)
        return Paths.concatenate([paths, targets])


def build_engine(table: TracingTable, scene: Scene, antenna: Antenna, chirp: Chirp, seed: int) -> Engine:
    """Return the engine that a scenario names."""
    if table.engine == "path_solver":
        from sionna_radar.tracing.path_solver import PathSolverEngine

        return PathSolverEngine(scene, antenna, chirp, seed, samples=table.paths_per_pulse)
    from sionna_radar.tracing.beam_solver import BeamEngine

    return BeamEngine(scene, antenna, chirp, seed, table.paths_per_pulse, table.side_lobe_share)
