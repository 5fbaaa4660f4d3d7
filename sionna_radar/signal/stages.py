"""The stages of a non-ideal receiver in their physical order, and the registry of custom stages.

Each stage transforms the signal received so far. The mixer synthesises a signal from paths, on a grid of times that may
be finer and longer than the samples; noise is kept separately; the filters attenuate both and sample them.
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
from sionna_radar.scenario.registry import registers, require
from sionna_radar.signal.analog_filters import AntiAlias, HighPass, build_anti_alias
from sionna_radar.signal.beat import SampleGrid
from sionna_radar.tracing.paths import Paths

# Largest number of grid points of all pulses processed at once.
MAX_POINTS = 2**22
# In the order of the signal path.
ORDER: tuple[Place, ...] = ("leakage", "mixer", "interference", "noise", "filters", "converter")

Builder = TypeVar("Builder", bound=Callable[..., "ReceiverStage"])


@dataclass(frozen=True, kw_only=True)
class Received:
    """Signal of one sweep of a block of pulses, between the stages of a receiver.

    paths: echoes at the antenna, relative to the transmitted wave.
    grid: the samples of the sweep, and the points of the signal before sampling.
    sweep: number of the sweep within its pulse, of `sweeps`.
    transmit_power_w, noise_power_w: of the transmitted wave, and of the noise of a sample.
    seed: of all random numbers.
    channel: index of the receiver; all share one oscillator, and each has independent noise.
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
        """The samples, after the mixer."""
        assert self.samples is not None
        return self.samples


@runtime_checkable
class ReceiverStage(Protocol):
    """A stage of the receiver."""

    def __call__(self, received: Received) -> Received:
        """Return the signal after the stage; each pulse must be independent of the others in its block."""
        ...


@dataclass(frozen=True, kw_only=True)
class StageInputs:
    """Inputs to the builder of a stage.

    radar: the radar of the scenario.
    sweeps: of a pulse.
    high_pass, anti_alias: of the receiver; None if it has none.
    interference: adds what other radars radiate; None if there are none.
    """

    radar: RadarTable
    sweeps: tuple[Chirp, ...]
    high_pass: HighPass | None
    anti_alias: AntiAlias | None = None
    interference: ReceiverStage | None = None


@dataclass(frozen=True, kw_only=True)
class Chain:
    """All stages of a receiver, and the parameters of their grid.

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
        """Return one sweep after all stages, in blocks of pulses that bound the memory."""
        block_size = max(1, MAX_POINTS // received.grid.wide.samples)
        pulses = received.pulses
        if len(pulses) <= block_size:
            return self._staged(received)
        blocks = []
        for start in range(0, len(pulses), block_size):
            block = pulses.rows(slice(start, start + block_size))
            path_rows = slice(*np.searchsorted(received.paths.pulse, (block.index[0], block.index[-1] + 1)))
            blocks.append(self._staged(replace(received, pulses=block, paths=received.paths.rows(path_rows))))
        saturated = [block_received.saturated for block_received in blocks if block_received.saturated is not None]
        return replace(
            received,
            samples=np.concatenate([block_received.signal for block_received in blocks]),
            saturated=np.concatenate(saturated) if saturated else None,
        )

    def _staged(self, received: Received) -> Received:
        received = replace(received, noise_points=self.noise_points)
        for stage in self.stages:
            received = stage(received)
        return received


@registers(RECEIVER_STAGES, "[radar.receiver.stages.NAME]")
def register_receiver_stage(name: str, parameters: type[StageParameters]) -> Callable[[Builder], Builder]:
    """Register a stage of the receiver, for `radar.receiver.stages` in a scenario.

    It decorates a class or function that builds a `ReceiverStage`; it is called with the parameters, and with
    `StageInputs`.

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


# Samples over which a signal fades in and out; residual of a filter's transient when sampling begins.
FADE_SAMPLES, SETTLED = 64, 1e-4
# Largest guard, in sweeps.
LONGEST_GUARD = 2
# Points per sample before an anti-alias filter, and its largest power response at the edge of their band.
OVERSAMPLINGS, PASSED = (2, 4, 8), 1e-4
# Points per sample with interference of other radars.
CROSSING = 4


def build_chain(
    radar: RadarTable,
    sweeps: tuple[Chirp, ...],
    high_pass: HighPass | None,
    interference: ReceiverStage | None = None,
) -> Chain | None:
    """Return the stages of a scenario's receiver; None for an ideal one with only noise and a high-pass."""
    anti_alias = build_anti_alias(radar.receiver, sweeps[0])
    inputs = StageInputs(
        radar=radar, sweeps=sweeps, high_pass=high_pass, anti_alias=anti_alias, interference=interference
    )
    if not _real(inputs):
        return None
    stages = []
    for slot in ORDER:
        chosen = radar.receiver.stages.get(slot) or StageParameters(stage=slot)
        stage: ReceiverStage = RECEIVER_STAGES.entry(chosen.stage)(chosen, inputs)
        require(stage, ReceiverStage, str(RECEIVER_STAGES.entry(chosen.stage)))
        stages.append(stage)
    oversampling = _oversampling(inputs)
    return Chain(
        stages=tuple(stages),
        oversampling=oversampling,
        guard=_guard(high_pass, anti_alias, sweeps[0], oversampling),
        noise_points=1 if anti_alias is None else oversampling,
    )


def _real(inputs: StageInputs) -> bool:
    """Return whether a receiver has other effects than noise and a high-pass."""
    receiver = inputs.radar.receiver
    oscillator, converter = receiver.oscillator, receiver.converter
    effects = (
        oscillator.bent,
        oscillator.levels_dbc_hz,
        oscillator.scale != 1,
        converter.limited,
        converter.imbalanced,
    )
    return any((*effects, receiver.leakage, receiver.stages, inputs.anti_alias, inputs.interference))


def _oversampling(inputs: StageInputs) -> int:
    """Return the points per sample required by the effects of a receiver."""
    oscillator, anti_alias = inputs.radar.receiver.oscillator, inputs.anti_alias
    # Twice the sampling rate covers every sideband of an in-band echo that an ideal filter passes.

    minimum = 2 if oscillator.bent or oscillator.levels_dbc_hz else 1
    # Bursts are cut off at the ends of the grid's band, far from what is sampled.
    minimum = CROSSING if inputs.interference is not None else minimum
    if anti_alias is None:
        return minimum
    sufficient = (n for n in OVERSAMPLINGS if n >= minimum and anti_alias.left(n) < PASSED)
    return next(sufficient, OVERSAMPLINGS[-1])


def _guard(high_pass: HighPass | None, anti_alias: AntiAlias | None, chirp: Chirp, oversampling: int) -> int:
    """Return the samples before the first one: half of them to fade in, half for filters to settle."""
    rates = [filter_.slowest_rad_s for filter_ in (high_pass, anti_alias) if filter_ is not None]
    if not rates:
        return 0 if oversampling == 1 else 2 * FADE_SAMPLES
    settling = int(np.ceil(-np.log(SETTLED) / min(rates) * chirp.sampling_rate_hz))
    return min(2 * max(FADE_SAMPLES, settling), LONGEST_GUARD * chirp.samples)
