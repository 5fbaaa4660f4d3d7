"""Tracing with an array whose beam is steered from pulse to pulse."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.scenario.weather import WeatherTable
from sionna_radar.tracing.engine import Engine, EngineInputs
from sionna_radar.tracing.paths import Paths
from sionna_radar.tracing.tracer import Tracer, build_tracer


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

    def rest(self) -> None:
        """Let the engines give back memory until more pulses are traced."""
        for tracer in self._tracers:
            tracer.rest()


def build_steered_tracer(engine: Engine, given: EngineInputs, weather: WeatherTable) -> SteeredTracer:
    """Return the tracer of all beams, with engines that share what they know of the scene.

    Raises ScenarioError for an engine that cannot change its antenna.
    """
    change = getattr(engine, "with_antenna", None)
    if change is None:
        message = f"{type(engine).__name__} has no method with_antenna, which an electronic scan needs; set 'sionna'"
        raise ScenarioError([Problem("tracing.engine", message)])
    return SteeredTracer(
        [build_tracer(change(beam), replace(given, antenna=beam, beams=()), weather) for beam in given.beams]
    )
