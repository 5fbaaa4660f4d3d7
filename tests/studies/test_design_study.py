"""Designs of three parameters against the sweeps of all their combinations: their optima and their fronts.

    pytest -m study -n 0 -s tests/studies/test_design_study.py

flies 450 surveys for each sweep, and a tenth of them for each design; many minutes on two cores.
"""

from dataclasses import dataclass, field

import numpy as np
import pytest

from fronts import hypervolume
from sionna_radar.studies.design.plan import plan_design, standing_of
from sionna_radar.studies.design.study import run_design
from sionna_radar.studies.sweep.expressions import parse_requirement
from sionna_radar.studies.sweep.plan import plan_sweep
from sionna_radar.studies.sweep.quantities import quantities_of
from sionna_radar.studies.sweep.settings import label
from sionna_radar.studies.sweep.study import Sweep, run_sweep

pytestmark = pytest.mark.study

BEAM, HEIGHT = "radar.antenna.beamwidth_deg", "platform.altitude_m"
SHORT = {"platform.length_m": 24.0, "terrain.spacing_m": 2.0, "tracing.paths_per_pulse": 64}
SEEDS = 2
# Each further one a search of its own, over other surveys.
SEARCHES = (1000, 2000, 3000)
FRESH = {"seed": 5000}


@dataclass(eq=False)
class Study:
    """A scene, its grid, an objective in closed form, and the error that is required and, for the front, minimised.

    sign: -1 for an objective that is maximised. least: of the coverage; most: of the aperture, m.
    """

    source: str
    overrides: dict
    third: dict
    objective: str
    sign: int
    error: str
    limit: float
    most: float = np.inf
    least: float = 0.5
    swept: Sweep = field(init=False)

    @property
    def grid(self):
        beams, heights = [1.0, 1.4, 2.0, 2.4, 2.8, 3.4, 4.0, 5.6, 8.0], [40.0, 45.0, 50.0, 55.0, 60.0]
        return {BEAM: beams, HEIGHT: heights} | self.third

    @property
    def requirements(self):
        return [f"{self.error} < {self.limit}", *self.allowed]

    @property
    def allowed(self):
        return [f"coverage > {self.least}", *([f"aperture_m < {self.most}"] if np.isfinite(self.most) else [])]

    def plan(self, seed, requirements, *errors):
        """Return the plan of a search with a tenth of the surveys of the sweep."""
        aim = {"minimise": [*errors], "maximise": []}
        aim["minimise" if self.sign > 0 else "maximise"].insert(0, self.objective)
        free = [f"{key}={','.join(map(str, values))}" for key, values in self.grid.items()]
        surveys = len(self.swept.cases) * SEEDS // 10
        overrides = SHORT | self.overrides | {"seed": seed}
        return plan_design(self.source, free, **aim, require=requirements, overrides=overrides, surveys=surveys)

    def cost(self, case):
        """Return the objective of a case as it is minimised."""
        return round(self.sign * quantities_of(case.scenario, names=[self.objective])[self.objective], 6)

    def flown_again(self, setting):
        """Return a setting flown with ten seeds that neither sweep nor search has seen."""
        varied = {key: [value] for key, value in setting.items()}
        return run_sweep(plan_sweep(self.source, varied, 10, SHORT | self.overrides | FRESH)).cases[0]

    def margin(self, case):
        return standing_of(parse_requirement(self.requirements[0]), self.limit - case.of_trials(self.error))

    def allows(self, case):
        aperture_m = quantities_of(case.scenario, names=["aperture_m"])["aperture_m"]
        mapped = "coverage_of_swath"
        keeps_swath = case.mean(mapped) > 0.95 * max(other.mean(mapped) for other in self.swept.cases if other.trials)
        return case.mean("coverage") > self.least and aperture_m < self.most and keeps_swath


STUDIES = [
    Study(
        source="hills",
        overrides={},
        third={"radar.scan.rotation_rpm": [60.0, 90.0, 120.0, 180.0, 240.0]},
        objective="aperture_m",
        sign=1,
        error="rms_m",
        limit=0.15,
    ),
    Study(
        source="buildings",
        overrides={"dem.method": "linear"},
        third={"radar.scan.half_swath_deg": [25.0, 35.0, 45.0, 52.0, 60.0]},
        objective="area_per_hour_km2",
        sign=-1,
        error="le90_m",
        limit=0.25,
        most=0.1,
    ),
]


@pytest.fixture(scope="module", params=STUDIES, ids=lambda study: study.source)
def study(request):
    request.param.swept = run_sweep(
        plan_sweep(request.param.source, request.param.grid, SEEDS, SHORT | request.param.overrides)
    )
    return request.param


def test_a_tenth_of_the_surveys_finds_the_optimum_of_the_sweep(study):
    """The least cost whose error holds: of the sweep the first one, by cost, that ten fresh seeds confirm."""
    met = [case for case in study.swept.cases if case.mean(study.error) < study.limit and study.allows(case)]
    met.sort(key=lambda case: (study.cost(case), case.mean(study.error)))
    best, costs = None, [study.cost(case) for case in met]
    for cost in dict.fromkeys(costs):
        candidate = met[costs.index(cost)]
        again = study.flown_again(candidate.setting)
        margin = study.margin(again)
        print(f"sweep: {label(candidate.setting)}: {cost:.4g}, error {again.mean(study.error):.4f} m, {margin}")
        if margin.probability >= 0.9:
            best = cost
            break
    same = 0
    for seed in SEARCHES:
        found = run_design(study.plan(seed, study.requirements))
        again = study.flown_again(found.best.setting)
        error, spread = again.mean(study.error), again.spread(study.error)
        print(f"design {seed}: {found!r}; ten fresh seeds: error {error:.4f} +- {spread:.4f}")
        assert found.surveys <= len(study.swept.cases) * SEEDS // 10
        assert error < study.limit
        # The same cost: other settings of the same one are as good. Or the check with five seeds, whose scatter is of
        # the size of the margin, did not confirm it.
        reached = round(study.sign * found.best.objectives[0], 6)
        tried = [one for one in found.checked if round(study.sign * one.objectives[0], 6) == best]
        same += reached <= best
        assert reached <= best or (tried and tried[0].probability < 0.9)
    assert same >= len(SEARCHES) - 1


def test_a_tenth_of_the_surveys_finds_the_front_of_the_sweep(study):
    known = {
        label({key: float(value) for key, value in case.setting.items()}): (study.cost(case), case.mean(study.error))
        for case in study.swept.cases
        if study.allows(case)
    }
    points = np.array(list(known.values()))
    corner = points.max(axis=0) + 0.1 * np.abs(points.max(axis=0))
    for seed in SEARCHES:
        found = run_design(study.plan(seed, study.allowed, study.error))
        names = [label({key: float(value) for key, value in one.setting.items()}) for one in found.front]
        front = np.array([known[name] for name in names if name in known])
        share = hypervolume(front, corner) / hypervolume(points, corner)
        print(f"design {seed}: {found.surveys} surveys, {len(front)} points, hypervolume {share:.4f} of the sweep's")
        assert found.surveys <= len(study.swept.cases) * SEEDS // 10
        assert share > 0.98
