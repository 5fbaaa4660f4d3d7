"""Times of several actions, measured one after the other so that whatever else the machine does slows all of them."""

from collections.abc import Callable, Sequence
from time import perf_counter

import numpy as np
from jaxtyping import Float

from sionna_radar.flight.pulses import Pulses
from sionna_radar.survey.preparation import Prepared
from sionna_radar.tracing.paths import Paths

Action = Callable[[], object]


def seconds_of(action: Action) -> float:
    """Return how long an action takes."""
    start = perf_counter()
    action()
    return perf_counter() - start


def side_by_side(actions: Sequence[Action], repeats: int) -> Float[np.ndarray, "repeat action"]:
    """Return the seconds of each action in each repetition, after one that does not count."""
    for action in actions:
        action()
    return np.array([[seconds_of(action) for action in actions] for _ in range(repeats)])


def bare_casting(prepared: Prepared, paths: Paths, pulses: Pulses) -> Action:
    """Return a function that intersects the rays of paths with the scene, by Mitsuba, and does nothing else."""
    row = paths.pulse - pulses.index[0]
    origin = pulses.true.position_m[row]
    away = paths.hit_m - origin
    rays = prepared.scene.caster.prepare(origin, away / np.linalg.norm(away, axis=1, keepdims=True))
    return lambda: prepared.scene.caster.intersect(rays)
