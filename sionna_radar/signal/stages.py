"""The stages of a receiver that is not ideal, in their physical order, and how a scenario names others.

Each stage is given what has been received so far, and returns it with its own part added. The mixer makes a signal of
paths, on a grid of times that may be finer and longer than the samples; noise stands beside it; the filters
attenuate both and sample them.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Inexact, Int

from sionna_radar.flight.pulses import Pulses
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scenario.bases import StageParameters
from sionna_radar.scenario.parts import RECEIVER_STAGES
from sionna_radar.scenario.radar import RadarTable
from sionna_radar.scenario.receiver import Place
from sionna_radar.scenario.registry import require
from sionna_radar.signal.anti_alias import AntiAlias, build_anti_alias
from sionna_radar.signal.high_pass import HighPass
from sionna_radar.signal.sample_grid import SampleGrid
from sionna_radar.tracing.paths import Paths

# In the order in which a wave passes them.
ORDER: tuple[Place, ...] = ("leakage", "mixer", "noise", "filters", "converter")

Builder = TypeVar("Builder", bound=Callable[..., "ReceiverStage"])


@dataclass(frozen=True, kw_only=True)
class Received:
    """What a receiver holds of one sweep of a block of pulses.

    paths: what reaches the antenna, over the transmitted wave.
    grid: the samples of the sweep, and the points at which its signal is made.
    sweep: number of the sweep within its pulse, of `sweeps`.
    transmit_power_w, noise_power_w: of the wave sent, and of the noise of a sample.
    seed: of all random numbers.
    channel: which of several receivers this is: they share their oscillator, and each has noise of its own.
    samples: the signal, sqrt(W): on the points of the grid from the mixer on, sampled from the filters on.
    noise: white noise on a grid without guards, until the filters add it; noise_points: its points in a sample.
    saturated: samples of each pulse that exceed the full scale of a converter; None without one.
    """

    paths: Paths
    pulses: Pulses
    grid: SampleGrid
    sweep: int
    sweeps: int
    transmit_power_w: float
    noise_power_w: float
    seed: int
    channel: int = 0
    samples: Inexact[np.ndarray, "pulse point"] | None = None
    noise: Inexact[np.ndarray, "pulse noise_point"] | None = None
    noise_points: int = 1
    saturated: Int[np.ndarray, " pulse"] | None = None

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
    high_pass, anti_alias: of the receiver; None if it has none.
    """

    radar: RadarTable
    sweeps: tuple[Chirp, ...]
    high_pass: HighPass | None
    anti_alias: AntiAlias | None = None


@dataclass(frozen=True, kw_only=True)
class Chain:
    """All stages of a receiver, and the grid that their signals need.

    oversampling, guard: see `SampleGrid`. noise_points: points of noise in a sample.
    """

    stages: tuple[ReceiverStage, ...]
    oversampling: int
    guard: int
    noise_points: int = 1

    @cached_property
    def _grids(self) -> dict[Chirp, SampleGrid]:
        return {}

    def grid(self, chirp: Chirp) -> SampleGrid:
        """Return the grid of a sweep."""
        return self._grids.setdefault(chirp, SampleGrid(chirp, self.oversampling, self.guard))

    def receive(self, received: Received) -> Received:
        """Return one sweep behind all stages."""
        received = replace(received, noise_points=self.noise_points)
        for stage in self.stages:
            received = stage(received)
        return received


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


# Samples over which a signal fades in and out; what is left of a filter's start when sampling begins.
FADE_SAMPLES, SETTLED = 64, 1e-4
# A guard is no longer than so many sweeps.
LONGEST_GUARD = 2
# Points in a sample before an anti-alias filter, and the power that is to pass it at the end of their band.
OVERSAMPLINGS, PASSED = (2, 4, 8), 1e-4


def build_chain(radar: RadarTable, sweeps: tuple[Chirp, ...], high_pass: HighPass | None) -> Chain | None:
    """Return the stages of a scenario's receiver; None where it is ideal but for noise and a high-pass."""
    receiver, oscillator = radar.receiver, radar.receiver.oscillator
    shaped = oscillator.bent or bool(oscillator.levels_dbc_hz)
    converted = receiver.converter.limited or receiver.converter.imbalanced
    anti_alias = build_anti_alias(receiver, sweeps[0])
    if not (shaped or oscillator.scale != 1 or anti_alias or receiver.leakage or converted or receiver.stages):
        return None
    given = StageInputs(radar=radar, sweeps=sweeps, high_pass=high_pass, anti_alias=anti_alias)
    stages = []
    for place in ORDER:
        chosen = receiver.stages.get(place) or StageParameters(stage=place)
        stage: ReceiverStage = RECEIVER_STAGES.entry(chosen.stage)(chosen, given)
        require(stage, ReceiverStage, str(RECEIVER_STAGES.entry(chosen.stage)))
        stages.append(stage)
    # Twice the sampling rate holds every side band that an ideal filter lets pass of an echo in the sampled band.
    oversampling = 2 if shaped else 1
    if anti_alias is not None:
        oversampling = next((n for n in OVERSAMPLINGS if anti_alias.left(n) < PASSED), OVERSAMPLINGS[-1])
    return Chain(
        stages=tuple(stages),
        oversampling=oversampling,
        guard=_guard(high_pass, anti_alias, sweeps[0], oversampling),
        noise_points=1 if anti_alias is None else oversampling,
    )


def _guard(high_pass: HighPass | None, anti_alias: AntiAlias | None, chirp: Chirp, oversampling: int) -> int:
    """Return the samples before the first one: half of them to fade in, half for filters to settle."""
    filters = [(f.corner_hz, f.order) for f in (high_pass, anti_alias) if f is not None]
    if not filters:
        return 0 if oversampling == 1 else 2 * FADE_SAMPLES
    # The slowest pole of a Butterworth filter lies at sin(pi / 2 order) of its corner from the axis.
    rate = min(2 * np.pi * corner_hz * np.sin(np.pi / (2 * order)) for corner_hz, order in filters)
    settling = int(np.ceil(-np.log(SETTLED) / rate * chirp.sampling_rate_hz))
    return min(2 * max(FADE_SAMPLES, settling), LONGEST_GUARD * chirp.samples)
