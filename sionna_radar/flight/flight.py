"""A flight over its ground, planned or recorded."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from sionna_radar.flight.trajectory import Trajectory

Heights = Callable[[Float[np.ndarray, "n 2"]], Float[np.ndarray, " n"]]


@dataclass(frozen=True, kw_only=True)
class Flight:
    """A flight over its ground.

    altitude_m, speed_mps: nominal height above ground and speed over it, which samplings and reference levels use.
    record: what a log gave for it, in plain tables; None for a planned flight.
    warnings: what a reader of its results must know.
    """

    trajectory: Trajectory
    altitude_m: float
    speed_mps: float
    record: dict[str, Any] | None = None
    warnings: tuple[str, ...] = ()
