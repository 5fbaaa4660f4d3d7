"""Paths in the memory of the ray tracer, from which beat signals are made there too."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Int

from sionna_radar.flight.pulses import Pulses
from sionna_radar.tracing.paths import Paths

# Where the paths of each pulse begin, and where they end.
Spans = tuple[Int[np.ndarray, " pulse"], Int[np.ndarray, " pulse"]]


@dataclass(frozen=True, kw_only=True)
class DevicePaths:
    """The paths of a block of pulses, as arrays of Dr.Jit; see `Paths` for what they hold.

    pulses: the block.
    spans: one or more parts of the arrays, each sorted by pulse.
    delay_s, range_rate_mps, gain: of 64, 32 and twice 32 bits; the gain of a path that is hidden is zero.
    paths: the same in the memory of the host, for whoever compares with the truth.
    """

    pulses: Pulses
    spans: tuple[Spans, ...]
    delay_s: Any
    range_rate_mps: Any
    gain: Any
    paths: Paths


@runtime_checkable
class DeviceTracing(Protocol):
    """An engine whose paths stay in the memory of the ray tracer."""

    def on_device(self, pulses: Pulses) -> Iterator[DevicePaths]:
        """Yield the paths of a block of pulses, a part of the block at a time."""
        ...
