"""What a design says of its optimum holds against the optimum it prints, the surveys it flew, and the law behind them.

Ten searches: nine of surveys pretended by laws that differ from search to search, one of real surveys.
"""

import json
import re
from dataclasses import dataclass

import numpy as np
import pytest

from sionna_radar.foundation.columns import packed
from sionna_radar.scenario import Scenario, load_scenario
from sionna_radar.studies.design import search, statement
from sionna_radar.studies.design.document import DOCUMENT, sentence, statements
from sionna_radar.studies.design.plan import FLAT, INACTIVE, RELAXED, plan_design, standing_of
from sionna_radar.studies.design.study import run_design
from sionna_radar.studies.sweep import trial as trials
from sionna_radar.studies.sweep.expressions import parse_requirement
from sionna_radar.studies.sweep.quantities import quantities_of

BEAM, HEIGHT, RPM = "radar.antenna.beamwidth_deg", "platform.altitude_m", "radar.scan.rotation_rpm"
OTHERS = dict.fromkeys(("count", "min_m", "max_m", "std_m", "mean_m", "nmad_m", "le68_m", "le95_m"), 0.1) | {
    "count": 900
}
NUMBER = r"(-?[0-9.]+(?:e[+-]?[0-9]+)?)"


@dataclass(frozen=True)
class Law:
    """The error of pretended surveys: a power law of beam and height, with a step where the scan is slow."""

    scale_m: float
    beam: float
    height: float
    noise: float

    def rms_m(self, setting):
        height, rpm = setting.get(HEIGHT, 40.0), setting.get(RPM, 120.0)
        return self.scale_m * setting[BEAM] ** self.beam * (height / 50) ** self.height * (1 + 20 / rpm)

    def pretended(self, task):
        scenario = Scenario.model_validate_json(task["scenario"])
        platform, radar = scenario.platform, scenario.radar
        setting = {BEAM: radar.antenna.beamwidth_deg, HEIGHT: platform.altitude_m, RPM: radar.scan.rotation_rpm}
        noise = np.random.default_rng(scenario.seed).standard_normal(2)
        rms_m, share = self.rms_m(setting) * (1 + self.noise * noise[0]), 0.9 + 0.004 * noise[1]
        error = OTHERS | {"rms_m": rms_m, "le90_m": 1.6 * rms_m, "p95_p5_m": 0.3, "coverage": share}
        trial = {"seed": scenario.seed, "echoes": 9, "points_sha256": "", "dem_error": error, "lit_error": error}
        rest = {"off_wall_error": None, "warnings": (), "stated_sigma_m": 0.1, "wall_s": 0.0, "peak_memory_mb": 0.0}
        return packed(trial=json.dumps(trial | rest | {"mapped_m2": 900.0, "coverage_of_swath": share}).encode())


ONE, TWO = [f"{BEAM}=1:6:log"], [f"{BEAM}=1:6:log", f"{HEIGHT}=30:50"]
WORDS = [*ONE, f"{RPM}=90,120,240"]
SEARCHES = [
    (Law(0.04, 1.0, 1.0, 0.05), ONE, {"minimise": ["aperture_m"], "require": ["rms_m < 0.1"]}),
    (Law(0.03, 1.2, 0.8, 0.03), TWO, {"minimise": ["aperture_m"], "require": ["rms_m < 0.1", "coverage > 0.5"]}),
    (Law(0.05, 0.7, 1.5, 0.02), TWO, {"maximise": ["area_per_hour_km2"], "require": ["rms_m < 0.12"]}),
    (Law(0.04, 1.0, 1.0, 0.08), ONE, {"minimise": ["aperture_m"], "require": ["le90_m < 0.15"]}),
    (Law(0.06, 0.5, 0.5, 0.03), TWO, {"minimise": ["rms_m"], "require": ["aperture_m < 0.1"]}),
    (Law(0.03, 1.0, 1.0, 0.04), WORDS, {"minimise": ["aperture_m * 10"], "require": ["rms_m < 0.1"]}),
    (Law(0.02, 1.5, 1.0, 0.04), TWO, {"maximise": ["radar.antenna.beamwidth_deg"], "require": ["rms_m < 0.1"]}),
    (Law(0.04, 1.0, 1.0, 0.04), ONE, {"minimise": ["aperture_m"], "require": ["rms_m < 9"]}),
    (Law(0.5, 1.0, 1.0, 0.04), ONE, {"minimise": ["aperture_m"], "require": ["rms_m < 0.1", "aperture_m < 1"]}),
]
MARKED = [pytest.param(*search, marks=() if n in (0, 6) else pytest.mark.study) for n, search in enumerate(SEARCHES)]


@pytest.mark.parametrize(("law", "free", "asked"), MARKED)
def test_statements_hold_against_the_printed_optimum_the_flights_and_the_law(small, monkeypatch, law, free, asked):
    for module, name, value in ((search, "POOL", 128), (search, "NEAR", 24), (statement, "SOBOL_SAMPLES", 64)):
        monkeypatch.setattr(module, name, value)
    monkeypatch.setattr(trials, "trial_task", law.pretended)
    design = run_design(plan_design(small, free, surveys=36, repeat=4, **asked))
    assert statements(design)
    holds_against_flights(design)
    holds_against_the_law(design, law)


@pytest.mark.study
def test_statements_of_flown_surveys_hold(small, capsys):
    asked = {"minimise": ["aperture_m"], "require": ["rms_m < 0.15", "coverage > 0.5"]}
    design = run_design(plan_design(small, [f"{BEAM}=1:5:log"], surveys=32, **asked))
    holds_against_flights(design)
    DOCUMENT.show(design)
    assert sentence(design) in capsys.readouterr().out.replace("\n", " ")


@pytest.mark.study
def test_a_flown_search_does_not_end_where_angles_repeat():
    """480 rpm at 360 chirps a second make 45 chirps a turn: the outer swath stays dark, and the rest errs the least."""
    short = {"platform.length_m": 24.0, "terrain.spacing_m": 2.0, "tracing.paths_per_pulse": 64, BEAM: 3.0, "seed": 1}
    free = [f"{RPM}=437.8,446.9,450,455,478,480"]
    design = run_design(plan_design("hills", free, minimise=["rms_m"], overrides=short, surveys=28, repeat=4))
    assert design.best.setting[RPM] != 480
    largest = max(one.results["coverage_of_swath"] for one in design.observations)
    assert design.best.values["coverage_of_swath"] > 0.95 * largest


def told(design, pattern):
    """Return the parts of all statements that fit a pattern."""
    return [found.groups() for text in statements(design) if (found := re.search(pattern, text))]


def stands_under(design, one, relaxed):
    """Return whether a design that was flown with several seeds meets all requirements, one of them relaxed or not."""
    flown = [o for o in design.observations if o.setting == one.setting and not o.reason]
    chances = [1.0]
    for text in design.plan.requirements:
        requirement = parse_requirement(text.text)
        values = {name: np.array([o.results.get(name, one.values[name]) for o in flown]) for name in text.names}
        by = RELAXED if text.text == relaxed else 0.0
        chances.append(standing_of(requirement, np.atleast_1d(requirement.margin(values, by))).probability)
    return min(chances) >= design.plan.confidence


def along(design, key):
    """Return the designs flown with several seeds that differ from the optimum in one key alone."""
    others = [name for name in design.plan.space.keys if name != key]
    return [one for one in design.checked if all(one.setting[k] == design.best.setting[k] for k in others)]


def holds_against_flights(design):
    objective, best = design.plan.objectives[0], design.best
    printed, sign = best.objectives[0], design.plan.objectives[0].sign
    assert f"{objective.expression.text} = {printed:.3g}" in sentence(design)
    if best.standing:
        assert f"(P = {best.probability:.2f})" in sentence(design)
    standing = [one for one in design.checked if one.probability >= design.plan.confidence]
    assert design.holds == bool(standing)
    assert all(sign * printed <= sign * one.objectives[0] for one in standing)
    for cut in design.slices:
        if len(cut.tolerance) < 2:
            continue
        assert design.holds
        assert best.setting[cut.key] in cut.tolerance
        for one in along(design, cut.key):
            low_to_high = cut.key != RPM and cut.tolerance[0] <= one.setting[cut.key] <= cut.tolerance[-1]
            if low_to_high or one.setting[cut.key] in cut.tolerance:
                assert one.probability >= design.plan.confidence
                assert abs(one.objectives[0] - printed) <= FLAT * abs(printed) * 1.001
    assert {within for (within,) in told(design, rf"within 5% of {NUMBER}")} <= {f"{printed:.3g}"}
    for name, start, end, without in told(
        design, rf"^(.*): active.*from {NUMBER} to about {NUMBER}, .* to about {NUMBER} \("
    ):
        assert start == f"{printed:.3g}"
        assert sign * float(without) <= sign * float(end) < sign * float(start)
        for one in design.checked:
            if stands_under(design, one, name):
                assert sign * one.objectives[0] >= sign * float(end) - 0.006 * abs(printed)
    for (name,) in told(design, r"^(.*): not active"):
        for one in design.checked:
            if stands_under(design, one, name):
                assert sign * one.objectives[0] >= sign * printed - INACTIVE * abs(printed)
    for (key,) in told(design, r"^([a-z_.]+): the optimum, .*end of its range"):
        span = next(span for span in design.plan.space.spans if span.key == key)
        step = (span.high / span.low) ** (1 / 40) if span.logarithmic else 1 + (span.high - span.low) / 40 / span.low
        assert min(best.setting[key] / span.low, span.high / best.setting[key]) <= step


def holds_against_the_law(design, law):
    """The statements are those of models fitted to noisy surveys: they may err by what the noise leaves open."""
    objective, best, sign = design.plan.objectives[0], design.best, design.plan.objectives[0].sign
    slack = 3 * law.noise / np.sqrt(best.seeds)
    margins = {text.text: parse_requirement(text.text) for text in design.plan.requirements}

    def values(setting):
        scenario = load_scenario(design.plan.source, setting)
        rms_m, shares = law.rms_m(setting), {"coverage": 0.9, "coverage_of_swath": 0.9}
        return quantities_of(scenario) | setting | {"rms_m": rms_m, "le90_m": 1.6 * rms_m} | shares

    def reached(known):
        return float(objective.expression.value(known))

    def meets(known, relaxed=None, by=0.0):
        return all(r.margin(known, by if name == relaxed else 0.0) > 0 for name, r in margins.items())

    for cut in design.slices:
        for value in cut.tolerance if len(cut.tolerance) > 1 else ():
            setting = best.setting | {cut.key: value}
            assert abs(reached(values(setting)) - best.objectives[0]) <= (FLAT + slack) * abs(best.objectives[0])
            # Relaxed by what the noise leaves open.
            assert all(r.margin(values(setting), slack) > 0 for r in margins.values())
    if not design.holds:
        return
    settings = design.plan.space.settings(np.random.default_rng(1).random((1500, len(design.plan.space.keys))))
    grid = [values(setting) for setting in settings] if design.relaxations else []
    for relaxation in design.relaxations:
        name = relaxation.requirement
        least = {by: min(sign * reached(known) for known in grid if meets(known, name, by)) for by in (0.0, RELAXED)}
        saving = (least[0.0] - least[RELAXED]) / abs(least[0.0])
        assert relaxation.saving == pytest.approx(saving, abs=0.02 + slack)
