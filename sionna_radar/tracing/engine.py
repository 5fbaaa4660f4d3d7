"""The interface of tracing engines, their inputs, and their registration under a name.

Among the inputs are beams of pulses spread over the survey, known before the flight.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.columns import Columns
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scenario.parts import ENGINES
from sionna_radar.scenario.registry import registers, require
from sionna_radar.scenario.table import Table
from sionna_radar.scenario.tracing import TracingTable
from sionna_radar.scene.model import Scene
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.tracing.paths import Paths


@dataclass(frozen=True, kw_only=True)
class SampledBeams(Columns):
    """Beams of pulses spread over a survey.

    range_m: along the axis to the surface; infinite for a beam that meets none.
    beam: which of the antennas each looks through.
    """

    position_m: Float[np.ndarray, "look 3"]
    R_world_antenna: Float[np.ndarray, "look 3 3"]
    range_m: Float[np.ndarray, " look"]
    beam: Int[np.ndarray, " look"]

    @property
    def hit_m(self) -> Float[np.ndarray, "look 3"]:
        """Where the axes meet the surface."""
        return self.position_m + self.range_m[:, None] * self.R_world_antenna[:, :, 0]


Builder = TypeVar("Builder", bound=Callable[..., "Engine"])


@runtime_checkable
class Engine(Protocol):
    """Traces the surfaces of a scene."""

    def trace(self, pulses: Pulses) -> Paths:
        """Return the paths of a block of pulses."""
        ...


@runtime_checkable
class SteerableEngine(Engine, Protocol):
    """An engine for the beams of an electronic scan."""

    def with_antenna(self, antenna: Antenna) -> Engine:
        """Return the same engine with another antenna."""
        ...


@dataclass(frozen=True, kw_only=True)
class EngineInputs:
    """Inputs of an engine.

    tracing: the scenario's `[tracing]`.
    caster: rays against the scene's surfaces, for engines that do not trace fields themselves.
    region_m: lowest and highest corner of the box that the survey can see.
    looks: beams of pulses spread over the survey, for what depends on how the scene is looked at.
    beams: the antenna steered to each beam of an electronic scan, by number; for a `SteerableEngine`.
    """

    tracing: TracingTable
    scene: Scene
    antenna: Antenna
    chirp: Chirp
    seed: int
    caster: RayCaster
    region_m: Float[np.ndarray, "2 3"]
    looks: SampledBeams
    beams: tuple[Antenna, ...] = ()


@registers(ENGINES, "[tracing.engine_parameters]")
def register_engine(name: str, parameters: type[Table] | None = None) -> Callable[[Builder], Builder]:
    """Register a tracing engine, for `tracing.engine` in a scenario.

    It decorates a class or function that builds an `Engine`; it is called with the parameters, if any, and with
    `EngineInputs`.

    Examples
    --------
    >>> import numpy as np
    >>> from sionna_radar.tracing import Paths
    >>> @register_engine("one_ray")
    ... class OneRay:
    ...     def __init__(self, given):
    ...         self.caster = given.caster
    ...     def trace(self, pulses):
    ...         hits = self.caster.cast(pulses.true.position_m, pulses.true.boresight)
    ...         row = np.flatnonzero(hits.hit)
    ...         return Paths.along_boresight(
    ...             pulses, row, hits.distance_m[row], gain=np.full(len(row), 1e-6 + 0j),
    ...             incidence_rad=np.arccos(hits.cosine[row]), surface=hits.surface[row],
    ...         )
    >>> overrides = {"tracing.engine": "one_ray", "platform.length_m": 10.0}
    >>> run(load_scenario("hills", overrides)).paths
    100

    """
    return ENGINES.register(name, parameters)


def build_engine(table: TracingTable, given: EngineInputs) -> Engine:
    """Return the engine named in a scenario."""
    engine: Engine = ENGINES.entry(table.engine)(table.engine_parameters, given)
    require(engine, Engine, str(ENGINES.entry(table.engine)))
    return engine
