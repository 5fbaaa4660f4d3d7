"""A planned flight compared with its area: flown over the terrain, how finely it samples every place.

A plan is made for level ground. Here its beam axes are cast on the terrain of its scenario; where they meet it within
the range that the radar samples, there is an echo. In the middle of a square of echoes s apart a place is s / sqrt(2)
from the nearest, so sqrt(2) times that distance is taken as the sampling at a place.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.constants import speed_of_light
from scipy.spatial import KDTree

from sionna_radar.foundation.progress import Progress, silent
from sionna_radar.scenario import Scenario
from sionna_radar.studies.planning import FlightPlan
from sionna_radar.survey.preparation import prepare
from sionna_radar.tracing.boresight import trace_boresights

# Places that the area is looked at, per sampling and in all.
PLACES_PER_SAMPLE = 4
MOST_PLACES = 1_000_000
PULSES_AT_ONCE = 4096


@dataclass(frozen=True, kw_only=True)
class PlanCheck:
    """The sampling that a flown plan achieves.

    pulses: how many were flown.
    place_m: places all over the area, its border included, east and north; rows lie along the area's heading.
    sampling_m: the sampling there, sqrt(2) times the distance on the map to the nearest echo.
    """

    plan: FlightPlan
    pulses: int
    place_m: Float[np.ndarray, "row column 2"]
    sampling_m: Float[np.ndarray, "row column"]

    @property
    def coverage(self) -> float:
        """Share of the area that is sampled as finely as wanted."""
        return float(np.mean(self.sampling_m <= self.plan.wanted.sampling_m * (1 + 1e-9)))

    @property
    def coarsest_m(self) -> float:
        """Sampling at the worst place."""
        return float(self.sampling_m.max())

    def sampling_of(self, share: float) -> float:
        """Return the sampling that a share of the area has, or a finer one."""
        return float(np.quantile(self.sampling_m, share))


def check_plan(plan: FlightPlan, scenario: Scenario, progress: Progress = silent) -> PlanCheck:
    """Fly a plan over the terrain of its scenario, and return how finely it samples the area.

    Parameters
    ----------
    plan:
        The flight.
    scenario:
        The scenario of `planned_scenario`.
    progress:
        Called at the start of each stage and after each of its steps.

    Raises
    ------
    ScenarioError, InputFileError
        It cannot be flown there; see `prepare`.

    """
    prepared = prepare(scenario, progress=progress)
    echoes = []
    for pulses in prepared.flight.blocks(PULSES_AT_ONCE):
        paths = trace_boresights(pulses, prepared.scene.caster)
        in_range = paths.delay_s * speed_of_light / 2 < prepared.receiver.chirp.max_range_m
        echoes.append(paths.hit_m[in_range, :2])
        progress("checking", int(pulses.index[-1]) + 1, len(prepared.flight))
    place = places(plan)
    away, _ = KDTree(np.concatenate(echoes)).query(place)
    return PlanCheck(plan=plan, pulses=len(prepared.flight), place_m=place, sampling_m=math.sqrt(2) * away)


def places(plan: FlightPlan) -> Float[np.ndarray, "row column 2"]:
    """Return places all over the area of a plan, east and north."""
    right, along = plan.wanted.size_m
    step = max(plan.wanted.sampling_m / PLACES_PER_SAMPLE, math.sqrt(right * along / MOST_PLACES))
    columns, rows = (max(2, math.ceil(side / step) + 1) for side in (right, along))
    x, y = np.meshgrid(np.linspace(-right / 2, right / 2, columns), np.linspace(-along / 2, along / 2, rows))
    return plan.wanted.to_world(np.column_stack([x.ravel(), y.ravel()])).reshape(rows, columns, 2)
