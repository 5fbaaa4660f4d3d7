"""A design of three parameters against the sweep of all their combinations: its optimum and its front.

    pytest -m study -n 0 -s tests/studies/test_design_study.py

flies 450 surveys for the sweep, and a tenth of them for each design; minutes on two cores.
"""

import numpy as np
import pytest

from sionna_radar.studies.design_search import run_design
from sionna_radar.studies.quantities import parse_requirement, quantities_of
from sionna_radar.studies.radar_design import plan_design, standing_of
from sionna_radar.studies.surrogate import hypervolume
from sionna_radar.studies.sweep import label, plan_sweep, run_sweep

pytestmark = pytest.mark.study

BEAM = "radar.antenna.beamwidth_deg"
SHORT = {"platform.length_m": 24.0, "terrain.spacing_m": 2.0, "tracing.paths_per_pulse": 64}
GRID = {
    BEAM: [1.0, 1.4, 2.0, 2.4, 2.8, 3.4, 4.0, 5.6, 8.0],
    "platform.altitude_m": [40.0, 45.0, 50.0, 55.0, 60.0],
    "radar.scan.rotation_rpm": [60.0, 90.0, 120.0, 180.0, 240.0],
}
FREE = [f"{key}={','.join(map(str, values))}" for key, values in GRID.items()]
SEEDS = 2
# Each further one a search of its own, over other surveys.
SEARCHES = (1000, 2000, 3000)
FRESH = {"seed": 5000}
LIMIT = parse_requirement("rms_m < 0.15")


@pytest.fixture(scope="module")
def swept():
    return run_sweep(plan_sweep("hills", GRID, SEEDS, SHORT))


def aperture_m(case) -> float:
    return quantities_of(case.scenario, names=["aperture_m"])["aperture_m"]


def flown_again(settings):
    """Return the settings flown with ten seeds that neither sweep nor search has seen, by their names."""
    flown = {}
    for setting in settings:
        one = plan_sweep("hills", {key: [value] for key, value in setting.items()}, 10, SHORT | FRESH)
        flown[label(setting)] = run_sweep(one).cases[0]
    return flown


def test_a_tenth_of_the_surveys_finds_the_optimum_of_the_sweep(swept):
    """The least aperture whose error holds: of the sweep the first one, by size, that ten fresh seeds confirm."""
    surveys = len(swept.cases) * SEEDS // 10
    met = [case for case in swept.cases if case.mean("rms_m") < 0.15 and case.mean("coverage") > 0.5]
    met.sort(key=lambda case: (round(aperture_m(case), 6), case.mean("rms_m")))
    best, margin = None, None
    for size in dict.fromkeys(round(aperture_m(case), 6) for case in met):
        candidate = next(case for case in met if round(aperture_m(case), 6) == size)
        again = flown_again([candidate.setting])[label(candidate.setting)]
        margin = standing_of(LIMIT, 0.15 - again.of_trials("rms_m"))
        print(f"sweep: {label(candidate.setting)}: aperture {size:.4f} m, RMS {again.mean('rms_m'):.4f} m, {margin}")
        if margin.probability >= 0.9:
            best = candidate
            break
    same = 0
    for seed in SEARCHES:
        plan = plan_design(
            "hills",
            FREE,
            minimise=["aperture_m"],
            require=["rms_m < 0.15", "coverage > 0.5"],
            overrides=SHORT | {"seed": seed},
            surveys=surveys,
        )
        found = run_design(plan)
        again = flown_again([found.best.setting])[label(found.best.setting)]
        print(
            f"design {seed}: {found!r}; ten fresh seeds: RMS {again.mean('rms_m'):.4f} +- {again.spread('rms_m'):.4f}"
        )
        assert found.surveys <= surveys
        assert again.mean("rms_m") < 0.15
        # The same beam: other heights and rotations cost nothing here. Or the check with five seeds, whose scatter is
        # of the size of the margin, did not confirm it.
        beam = best.setting[BEAM]
        tried = [one for one in found.checked if one.setting[BEAM] == beam]
        same += found.best.setting[BEAM] == beam
        assert found.best.setting[BEAM] == beam or tried[0].probability < 0.9
    assert same >= len(SEARCHES) - 1


def test_a_tenth_of_the_surveys_finds_the_front_of_the_sweep(swept):
    surveys = len(swept.cases) * SEEDS // 10
    known = {
        label({key: float(value) for key, value in case.setting.items()}): (aperture_m(case), case.mean("rms_m"))
        for case in swept.cases
        if case.mean("coverage") > 0.5
    }
    points = np.array(list(known.values()))
    corner = 1.1 * points.max(axis=0)
    for seed in SEARCHES:
        plan = plan_design(
            "hills",
            FREE,
            minimise=["aperture_m", "rms_m"],
            require=["coverage > 0.5"],
            overrides=SHORT | {"seed": seed},
            surveys=surveys,
        )
        found = run_design(plan)
        names = [label({key: float(value) for key, value in one.setting.items()}) for one in found.front]
        front = np.array([known[name] for name in names if name in known])
        share = hypervolume(front, corner) / hypervolume(points, corner)
        print(f"design {seed}: {found.surveys} surveys, {len(front)} points, hypervolume {share:.4f} of the sweep's")
        assert found.surveys <= surveys
        assert share > 0.98
