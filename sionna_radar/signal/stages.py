"""The stages of a receiver that is not ideal, in their physical order, and how a scenario names others.

Each stage is given what has been received so far, and returns it with its own part added. The mixer makes a signal of
paths, on a grid of times that may be finer and longer than the samples; noise stands beside it; the filters
attenuate both and sample them.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Inexact

from sionna_radar.flight.pulses import Pulses
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scenario.bases import StageParameters
from sionna_radar.scenario.parts import RECEIVER_STAGES
from sionna_radar.scenario.radar import RadarTable
from sionna_radar.scenario.receiver import Place
from sionna_radar.scenario.registry import require
from sionna_radar.signal.high_pass import HighPass
from sionna_radar.signal.sample_grid import SampleGrid
from sionna_radar.tracing.paths import Paths

# In the order in which a wave passes them.
ORDER: tuple[Place, ...] = ("mixer", "noise", "filters")

Builder = TypeVar("Builder", bound=Callable[..., "ReceiverStage"])


@dataclass(frozen=True, kw_only=True)
class Received:
    """What a receiver holds of one sweep of a block of pulses.

    paths: what reaches the antenna, over the transmitted wave.
    grid: the samples of the sweep, and the points at which its signal is made.
    sweep: number of the sweep within its pulse, of `sweeps`.
    transmit_power_w, noise_power_w: of the wave sent, and of the noise of a sample.
    seed: of all random numbers.
    samples: the signal, sqrt(W): on the points of the grid from the mixer on, sampled from the filters on.
    noise: white noise on a grid without guards, until the filters add it.
    """

    paths: Paths
    pulses: Pulses
    grid: SampleGrid
    sweep: int
    sweeps: int
    transmit_power_w: float
    noise_power_w: float
    seed: int
    samples: Inexact[np.ndarray, "pulse point"] | None = None
    noise: Inexact[np.ndarray, "pulse noise_point"] | None = None

    @property
    def chirp(self) -> Chirp:
        """The sweep with its samples."""
        return self.grid.chirp

    @property
    def signal(self) -> Inexact[np.ndarray, "pulse point"]:
        """The samples, of a stage behind the mixer."""
        assert self.samples is not None
        return self.samples


@runtime_checkable
class ReceiverStage(Protocol):
    """A stage of the receiver."""

    def __call__(self, received: Received) -> Received:
        """Return what is received behind the stage; a pulse's own must not depend on the others of its block."""
        ...


@dataclass(frozen=True, kw_only=True)
class StageInputs:
    """What a stage is built from.

    radar: the radar of the scenario.
    sweeps: of a pulse.
    high_pass: of the receiver; None if it has none.
    """

    radar: RadarTable
    sweeps: tuple[Chirp, ...]
    high_pass: HighPass | None


@dataclass(frozen=True, kw_only=True)
class Chain:
    """All stages of a receiver, and the grid that their signals need."""

    stages: tuple[ReceiverStage, ...]
    oversampling: int
    guard: int

    @cached_property
    def _grids(self) -> dict[Chirp, SampleGrid]:
        return {}

    def grid(self, chirp: Chirp) -> SampleGrid:
        """Return the grid of a sweep."""
        return self._grids.setdefault(chirp, SampleGrid(chirp, self.oversampling, self.guard))

    def receive(self, received: Received) -> Inexact[np.ndarray, "pulse sample"]:
        """Return the samples of one sweep."""
        for stage in self.stages:
            received = stage(received)
        return received.signal


def register_receiver_stage(name: str, parameters: type[StageParameters]) -> Callable[[Builder], Builder]:
    """Register a stage of the receiver, for `radar.receiver.stages` in a scenario.

    Parameters
    ----------
    name:
        Its name in scenarios.
    parameters:
        Its table of parameters.

    Returns
    -------
    A decorator for a class or function that builds a `ReceiverStage`; it is called with the parameters, and with
    `StageInputs`.

    Raises
    ------
    PluginError
        The name is taken, or the parameters are not `StageParameters`.

    Examples
    --------
    >>> import dataclasses
    >>> from sionna_radar.scenario import StageParameters
    >>> @register_receiver_stage("deaf", StageParameters)
    ... def deaf(parameters, given):
    ...     return lambda received: dataclasses.replace(received, noise=0.0 * received.samples)
    >>> load_scenario("hills", {"radar.receiver.stages.noise": "deaf"}).radar.receiver.stages["noise"].stage
    'deaf'

    """
    return RECEIVER_STAGES.register(name, parameters)


def build_chain(radar: RadarTable, sweeps: tuple[Chirp, ...], high_pass: HighPass | None) -> Chain | None:
    """Return the stages of a scenario's receiver; None where it is ideal but for noise and a high-pass."""
    receiver = radar.receiver
    oscillator = receiver.oscillator
    shaped = oscillator.bent or bool(oscillator.levels_dbc_hz)
    if not (shaped or oscillator.scale != 1 or receiver.stages):
        return None
    given = StageInputs(radar=radar, sweeps=sweeps, high_pass=high_pass)
    stages = []
    for place in ORDER:
        chosen = receiver.stages.get(place) or StageParameters(stage=place)
        stage: ReceiverStage = RECEIVER_STAGES.entry(chosen.stage)(chosen, given)
        require(stage, ReceiverStage, str(RECEIVER_STAGES.entry(chosen.stage)))
        stages.append(stage)
    # Twice the sampling rate holds every side band that an ideal filter lets pass of an echo in the sampled band.
    oversampling = 2 if shaped else 1
    return Chain(stages=tuple(stages), oversampling=oversampling, guard=_guard(high_pass, sweeps[0], oversampling))


# Samples over which a signal fades in and out; what is left of a filter's start when sampling begins.
FADE_SAMPLES, SETTLED = 64, 1e-4
# A guard is no longer than so many sweeps.
LONGEST_GUARD = 2


def _guard(high_pass: HighPass | None, chirp: Chirp, oversampling: int) -> int:
    """Return the samples before the first one: half of them to fade in, half for filters to settle."""
    if high_pass is None:
        return 0 if oversampling == 1 else 2 * FADE_SAMPLES
    # The slowest pole of a Butterworth filter lies at sin(pi / 2 order) of its corner from the axis.
    rate = 2 * np.pi * high_pass.corner_hz * np.sin(np.pi / (2 * high_pass.order))
    settling = int(np.ceil(-np.log(SETTLED) / rate * chirp.sampling_rate_hz))
    return min(2 * max(FADE_SAMPLES, settling), LONGEST_GUARD * chirp.samples)
