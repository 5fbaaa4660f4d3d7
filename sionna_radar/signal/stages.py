"""Chain of receiver stages (leakage, mixer, interference, noise, filters, converter), and the interface of custom ones.

Each stage transforms the signal received so far. The mixer synthesises a signal from paths, on a grid of times that may
be finer and longer than the samples; noise is kept separately; the filters attenuate both and sample them.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Inexact, Int

from sionna_radar.flight.pulses import Pulses
from sionna_radar.radar.chirp import Chirp
from sionna_radar.signal.beat import SampleGrid
from sionna_radar.tracing.paths import Paths

# Largest number of grid points of all pulses processed at once.
MAX_POINTS = 2**22


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
