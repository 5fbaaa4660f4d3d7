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
from sionna_radar.scenario.registry import registers, require
from sionna_radar.signal.analog_filters import AntiAlias, HighPass, build_anti_alias
from sionna_radar.signal.beat import SampleGrid
from sionna_radar.tracing.paths import Paths

# On the grids of all pulses that are received at once.
MAX_POINTS = 2**22
# In the order in which a wave passes them.
ORDER: tuple[Place, ...] = ("leakage", "mixer", "interference", "noise", "filters", "converter")

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
        """Return the received signal behind the stage; each pulse must be independent of the others in its block."""
        ...


@dataclass(frozen=True, kw_only=True)
class StageInputs:
    """What a stage is built from.

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
        """Return one sweep behind all stages; of many pulses at once no more than memory is meant for."""
        most = max(1, MAX_POINTS // received.grid.wide.samples)
        pulses = received.pulses
        if len(pulses) <= most:
            return self._staged(received)
        parts = []
        for first in range(0, len(pulses), most):
            some = pulses.rows(slice(first, first + most))
            own = slice(*np.searchsorted(received.paths.pulse, (some.index[0], some.index[-1] + 1)))
            parts.append(self._staged(replace(received, pulses=some, paths=received.paths.rows(own))))
        saturated = [part.saturated for part in parts if part.saturated is not None]
        return replace(
            received,
            samples=np.concatenate([part.signal for part in parts]),
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


# Samples over which a signal fades in and out; what is left of a filter's start when sampling begins.
FADE_SAMPLES, SETTLED = 64, 1e-4
# A guard is no longer than so many sweeps.
LONGEST_GUARD = 2
# Points in a sample before an anti-alias filter, and the power that is to pass it at the end of their band.
OVERSAMPLINGS, PASSED = (2, 4, 8), 1e-4
# Points in a sample where sweeps of other radars cross ours.
CROSSING = 4


def build_chain(
    radar: RadarTable,
    sweeps: tuple[Chirp, ...],
    high_pass: HighPass | None,
    interference: ReceiverStage | None = None,
) -> Chain | None:
    """Return the stages of a scenario's receiver; None where it is ideal but for noise and a high-pass."""
    anti_alias = build_anti_alias(radar.receiver, sweeps[0])
    given = StageInputs(
        radar=radar, sweeps=sweeps, high_pass=high_pass, anti_alias=anti_alias, interference=interference
    )
    if not _real(given):
        return None
    stages = []
    for place in ORDER:
        chosen = radar.receiver.stages.get(place) or StageParameters(stage=place)
        stage: ReceiverStage = RECEIVER_STAGES.entry(chosen.stage)(chosen, given)
        require(stage, ReceiverStage, str(RECEIVER_STAGES.entry(chosen.stage)))
        stages.append(stage)
    oversampling = _oversampling(given)
    return Chain(
        stages=tuple(stages),
        oversampling=oversampling,
        guard=_guard(high_pass, anti_alias, sweeps[0], oversampling),
        noise_points=1 if anti_alias is None else oversampling,
    )


def _real(given: StageInputs) -> bool:
    """Return whether a receiver does more than to add noise and to filter it by a high-pass."""
    receiver = given.radar.receiver
    oscillator, converter = receiver.oscillator, receiver.converter
    effects = (
        oscillator.bent,
        oscillator.levels_dbc_hz,
        oscillator.scale != 1,
        converter.limited,
        converter.imbalanced,
    )
    return any((*effects, receiver.leakage, receiver.stages, given.anti_alias, given.interference))


def _oversampling(given: StageInputs) -> int:
    """Return the points in a sample that the effects of a receiver need."""
    oscillator, anti_alias = given.radar.receiver.oscillator, given.anti_alias
    # Twice the sampling rate holds every side band that an ideal filter lets pass of an echo in the sampled band.
    least = 2 if oscillator.bent or oscillator.levels_dbc_hz else 1
    # Bursts are cut off at the ends of the grid's band, far from what is sampled.
    least = CROSSING if given.interference is not None else least
    if anti_alias is None:
        return least
    wide = (n for n in OVERSAMPLINGS if n >= least and anti_alias.left(n) < PASSED)
    return next(wide, OVERSAMPLINGS[-1])


def _guard(high_pass: HighPass | None, anti_alias: AntiAlias | None, chirp: Chirp, oversampling: int) -> int:
    """Return the samples before the first one: half of them to fade in, half for filters to settle."""
    rates = [each.slowest_rad_s for each in (high_pass, anti_alias) if each is not None]
    if not rates:
        return 0 if oversampling == 1 else 2 * FADE_SAMPLES
    settling = int(np.ceil(-np.log(SETTLED) / min(rates) * chirp.sampling_rate_hz))
    return min(2 * max(FADE_SAMPLES, settling), LONGEST_GUARD * chirp.samples)
