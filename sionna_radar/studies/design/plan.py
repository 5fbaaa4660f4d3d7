"""Which radar do I need? The free parameters that meet requirements at the least cost, found with few surveys.

A plan names the free parameters, the objectives and the requirements; `run_design` flies it, and returns the result.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.stats import t

from sionna_radar.foundation.errors import InputFileError, RadarError, ScenarioError
from sionna_radar.foundation.raster import Raster
from sionna_radar.scenario import Scenario, load_scenario
from sionna_radar.scenario.loading import input_files
from sionna_radar.scenario.overrides import parse_overrides
from sionna_radar.studies.design.surrogate import Space, check_installed
from sionna_radar.studies.sweep.common_cells import AREAS_ALIKE
from sionna_radar.studies.sweep.costs import Costs
from sionna_radar.studies.sweep.expressions import (
    Expression,
    Requirement,
    check_consistent,
    check_names,
    parse_expression,
    parse_requirement,
)
from sionna_radar.studies.sweep.quantities import QUANTITIES, Area, key_value, quantities_of
from sionna_radar.studies.sweep.settings import Setting, is_whole, label, one_setting, parse_varied, refuse
from sionna_radar.studies.sweep.trial import OBSTACLE_STATISTICS, STATISTICS
from sionna_radar.survey.preparation import prepare
from sionna_radar.survey.swath import has_planned_swath

# Relative change of the objective that counts as a tolerance, and by which a limit is relaxed.
FLAT, RELAXED = 0.05, 0.10
# An objective that changes by less when a limit is relaxed does not depend on it.
INACTIVE = 0.005
MAX_SURVEYS = 2000
# Places between the corners of the space of which one must be flyable; the error of the first is shown otherwise.
TRIED = (0.5, 0.25, 0.75, 0.05, 0.95)
# Results of one survey; errors over common cells take several ones.
RESULTS = tuple(name for name in STATISTICS if name != "common_rms_m")
# Those that say how much ground is mapped.
MAPPED = ("mapped_m2", "mapped_swath_m", "coverage_of_swath")


@dataclass(frozen=True)
class Objective:
    """What is minimised, or with `sign` = -1 maximised."""

    expression: Expression
    sign: int = 1

    @property
    def text(self) -> str:
        """The expression with what is done to it."""
        return f"{'minimise' if self.sign > 0 else 'maximise'} {self.expression.text}"


@dataclass(frozen=True, kw_only=True)
class DesignPlan:
    """A search for a radar: see `plan_design`.

    worlds: source and overrides of each scenario that is flown; a result is the worst of them.
    surveys: flights in all, each in one world; repeat: seeds of the final check.
    confidence: probability with which every requirement must hold.
    keeps_swath: whether the last requirement is that of `keeping_swath`.
    """

    source: str
    base: Scenario
    worlds: tuple[tuple[str, Mapping[str, Any]], ...]
    space: Space
    objectives: tuple[Objective, ...]
    requirements: tuple[Requirement, ...]
    costs: Costs = field(default_factory=Costs)
    area: Area | None = None
    surveys: int = 60
    repeat: int = 5
    confidence: float = 0.9
    keeps_swath: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """All names that objectives, requirements and costs depend on, except the costs themselves."""
        parts: list[Expression | Requirement] = [*(o.expression for o in self.objectives), *self.requirements]
        named = dict.fromkeys(name for part in parts for name in part.names)
        needs = self.costs.needs if any(name in self.costs.names for name in named) else ()
        return tuple(name for name in dict.fromkeys((*named, *needs)) if name not in self.costs.names)

    @property
    def results(self) -> tuple[str, ...]:
        """Those of them that only a survey tells."""
        return tuple(name for name in self.names if name in RESULTS)

    def keeping_swath(self, largest: float) -> "DesignPlan":
        """Return the plan that also requires the `coverage_of_swath` of the best, but for `AREAS_ALIKE`.

        An error over lit cells is the smaller, the more of the hard cells stay dark: without it dark ground is a gain.
        """
        swath = parse_requirement(f"coverage_of_swath > {(1 - AREAS_ALIKE) * largest:.3g}")
        asked = self.requirements[:-1] if self.keeps_swath else self.requirements
        return replace(self, requirements=(*asked, swath), keeps_swath=True)

    def scenarios(self, setting: Mapping[str, Any], seed: int | None = None) -> list[Scenario]:
        """Return the scenarios of a setting; raises ScenarioError or InputFileError if one is refused."""
        seeds = {} if seed is None else {"seed": seed}
        return [load_scenario(source, {**overrides, **setting, **seeds}) for source, overrides in self.worlds]

    def identity(self) -> dict[str, Any]:
        """Return the inputs that determine the results, as a JSON document."""
        asked = [o.text for o in self.objectives], [r.text for r in self.requirements]
        costs = {part: {name: cost.text for name, cost in c.items()} for part, c in self.costs.components.items()}
        area = None if self.area is None else [*self.area.size_m, self.area.overlap]
        free = [repr(self.space.spans), repr(self.space.listed)]
        return {
            "design": [self.source, free, *asked, costs, area, self.surveys, self.repeat, self.confidence],
            "scenario": [repr(world) for world in self.worlds],
            "seed": self.base.seed,
            "input file": input_files(self.base),
        }


def plan_design(
    source: str | Path,
    free: Iterable[str],
    *,
    minimise: Iterable[str] = (),
    maximise: Iterable[str] = (),
    require: Iterable[str] = (),
    overrides: Mapping[str, Any] | None = None,
    worst_of: Iterable[str] = (),
    costs: Costs | None = None,
    area: Area | None = None,
    surveys: int = 60,
    repeat: int = 5,
    confidence: float = 0.9,
) -> DesignPlan:
    """Return the checked plan of a design.

    Parameters
    ----------
    source, overrides:
        The scenario, and dotted keys replaced in it.
    free:
        Free parameters, `KEY=LOW:HIGH[:log]` or `KEY=V1,V2,...`.
    minimise, maximise:
        One or two objectives in all: expressions over keys, quantities, errors and costs.
    require:
        Conditions that shall hold, such as `rms_m < 0.10`. If they or the objectives name results of the map, but
        neither `mapped_m2`, `mapped_swath_m` nor `coverage_of_swath`, each design must map as much of its planned swath
        as the best one.
    worst_of:
        Further worlds, each a scenario or `KEY=VALUE[;KEY=VALUE...]` in this one: a result is the worst of all.
    costs:
        Costs by component, from `read_costs`.
    area:
        The area of `flying_time_s` and `lines`; None for the scenario's own flight.
    surveys:
        Number of flights, those of the final check and of all worlds included.
    repeat:
        Seeds with which the optimum is checked.
    confidence:
        Probability with which each requirement must hold for the mean over seeds.

    Raises
    ------
    ScenarioError, InputFileError
        A name, an expression or a parameter is wrong, or no setting can be flown.

    Examples
    --------
    >>> short = {"platform.length_m": 10.0, "terrain.spacing_m": 2.0}
    >>> free = ["radar.antenna.beamwidth_deg=1:4:log"]
    >>> plan = plan_design("hills", free, minimise=["aperture_m"], require=["rms_m < 0.2"], overrides=short)
    >>> plan.results
    ('rms_m', 'coverage_of_swath')
    """
    check_installed()
    costs, overrides = costs or Costs(), dict(overrides or {})
    listed, spans = parse_varied(free, "--free")
    # Only with a value of each free key: without one it may be incomplete.
    base = load_scenario(source, overrides | one_setting(listed, spans))
    whole = frozenset(span.key for span in spans if is_whole(base, span.key))
    space = Space(spans, listed, whole)
    least = (Objective(parse_expression(text, "--minimise")) for text in minimise)
    most = (Objective(parse_expression(text, "--maximise"), -1) for text in maximise)
    plan = DesignPlan(
        source=str(source),
        base=base,
        worlds=((str(source), overrides), *(_world(text, str(source), overrides) for text in worst_of)),
        space=space,
        objectives=(*least, *most),
        requirements=tuple(parse_requirement(text) for text in require),
        costs=costs,
        area=area,
        surveys=surveys,
        repeat=repeat,
        confidence=confidence,
    )
    _check_request(plan)
    swath_known = _check_names(plan)
    # What is reported of obstacles gains nothing from ground left dark.
    of_map = set(plan.results) - set(OBSTACLE_STATISTICS)
    return plan.keeping_swath(0.0) if swath_known and of_map and not of_map & set(MAPPED) else plan


def _world(text: str, source: str, overrides: Mapping[str, Any]) -> tuple[str, Mapping[str, Any]]:
    if "=" not in text:
        return text, overrides
    return source, {**overrides, **parse_overrides(text.split(";"))}


def _check_request(plan: DesignPlan) -> None:
    keys = plan.space.keys
    twice = [key for index, key in enumerate(keys) if key in keys[:index]]
    fixed = [key for key in keys if any(key in overrides for _, overrides in plan.worlds)]
    if not keys:
        refuse("nothing is free; give at least one KEY=LOW:HIGH or KEY=V1,V2", "--free")
    if twice:
        refuse(f"{twice[0]} is free twice; name it once", "--free")
    if fixed:
        refuse(f"{fixed[0]} is both set and free; choose one", "--free")
    if "seed" in keys:
        refuse("seed is no part of a radar; --repeat flies several seeds", "--free")
    if not 1 <= len(plan.objectives) <= 2:
        refuse(f"{len(plan.objectives)} objectives; give one or two", "--minimise")
    if not 0.5 <= plan.confidence < 1:
        refuse(f"{plan.confidence:g} must be at least 0.5 and below 1", "--confidence")
    if plan.repeat < 2:
        refuse(f"{plan.repeat} seeds have no scatter; give at least 2", "--repeat")
    flights = (first_count(plan) + plan.repeat) * len(plan.worlds)
    if not flights <= plan.surveys <= MAX_SURVEYS:
        refuse(f"{plan.surveys} must be {flights} to {MAX_SURVEYS}: first settings and check", "--surveys")


def _check_names(plan: DesignPlan) -> bool:
    """Check all names against a setting that can be flown, and return whether the planned swath is known there."""
    known = [*RESULTS, *QUANTITIES, *plan.costs.names]
    parts: list[Expression | Requirement] = [*(o.expression for o in plan.objectives), *plan.requirements]
    for part in parts:
        check_names(part.names, known, f"{part.text!r}")
    check_consistent(plan.requirements)
    check_names(plan.costs.needs, [name for name in known if name not in plan.costs.names], "--costs")
    if not plan.results:
        refuse("no survey is needed for it; name rms_m, coverage or the like", "--require")
    refused: list[RadarError] = []
    for setting in plan.space.settings(np.repeat(np.array(TRIED)[:, None], len(plan.space.keys), axis=1)):
        try:
            scenarios = plan.scenarios(setting)
            prepared = [prepare(scenario) for scenario in scenarios]
        except (ScenarioError, InputFileError) as error:
            refused.append(error)
            continue
        for name in plan.names:
            if name in QUANTITIES and not np.isfinite(quantities_of(scenarios[0], plan.area, (name,))[name]):
                refuse(f"is undefined here: {QUANTITIES[name].undefined}", name)
            if name not in QUANTITIES and name not in RESULTS:
                key_value(scenarios[0], name)
        return all(map(has_planned_swath, prepared))
    raise refused[0]


@dataclass(frozen=True, kw_only=True)
class Observation:
    """One flown setting: its seed, and its results, the worst over all worlds; or the reason why there are none."""

    setting: Setting
    seed: int
    results: dict[str, float]
    method: str = ""
    reason: str = ""


@dataclass(frozen=True, kw_only=True)
class Standing:
    """How one requirement stands at a setting, over the seeds flown there.

    margin: its mean, positive where the requirement holds; spread: standard deviation from seed to seed.
    probability: that the mean over all seeds meets it; of_one_survey: that one further survey does.
    """

    requirement: str
    margin: float
    spread: float
    probability: float
    of_one_survey: float


@dataclass(frozen=True, kw_only=True)
class Checked:
    """A design that was flown with several seeds.

    values: quantities, keys, costs and mean results by name; spread: of the results from seed to seed.
    """

    setting: Setting
    scenario: Scenario
    seeds: int
    objectives: tuple[float, ...]
    values: dict[str, float]
    spread: dict[str, float]
    standing: tuple[Standing, ...]

    @property
    def probability(self) -> float:
        """The least probability of its requirements; 1 without any."""
        return min((standing.probability for standing in self.standing), default=1.0)


@dataclass(frozen=True, kw_only=True)
class Slice:
    """Results along one free parameter through the optimum, by the models; the optimum's own value is one of them.

    objectives: at each value. results: mean and standard deviation by name. holds: probability of all requirements.
    tolerance: the values, of a range without a gap around the optimum's, whose objective differs from the optimum's by
        at most `FLAT`, and at which all requirements hold with the confidence asked for, by the models and by all
        designs flown with several seeds. Empty for several objectives, and if the optimum does not meet all.
    at_end: whether the optimum lies at an end of its range, toward which the objective improves.
    """

    key: str
    values: tuple[Any, ...]
    objectives: Float[np.ndarray, "value objective"]
    results: dict[str, tuple[Float[np.ndarray, " value"], Float[np.ndarray, " value"]]]
    holds: Float[np.ndarray, " value"]
    tolerance: tuple[Any, ...] = ()
    at_end: bool = False


@dataclass(frozen=True, kw_only=True)
class Relaxation:
    """What a requirement costs: the objective expected with its limit relaxed by `RELAXED`, and without it.

    relaxed, without: the optimum's objective plus the change of the least expected one, by the models; no worse than
        what a design flown with several seeds reached under the relaxed limit. If the optimum does not meet all
        requirements, the least expected objective itself; NaN where no design is expected to meet what is left.
    saving: relative change of the objective by relaxing, positive for the better; NaN if the optimum does not meet all.
    """

    requirement: str
    relaxed: float
    without: float
    saving: float


@dataclass(frozen=True, kw_only=True)
class RadarDesign:
    """The result of a design.

    best: the optimum, checked with several seeds; of two objectives the point of the front nearest to the best of both.
    holds: whether all its requirements hold with the confidence asked for.
    checked: all designs flown with several seeds, best first; of several their values hold `common_rms_m`, over the
        lit cells that all of them filled with every seed. front: of two objectives. maps: name and height error over
        lit cells of the best of them, one seed each.
    sensitivity: total-order Sobol indices by result and objective, by key. noise: from seed to seed, by result;
    relative for errors.
    """

    plan: DesignPlan
    observations: tuple[Observation, ...]
    best: Checked
    holds: bool
    checked: tuple[Checked, ...]
    front: tuple[Checked, ...]
    maps: tuple[tuple[str, Raster], ...]
    slices: tuple[Slice, ...]
    relaxations: tuple[Relaxation, ...]
    sensitivity: dict[str, dict[str, float]]
    noise: dict[str, float]

    @property
    def surveys(self) -> int:
        """Number of flights."""
        return len(self.observations) * len(self.plan.worlds)

    def __repr__(self) -> str:
        reached = ", ".join(
            f"{objective.expression.text} = {value:.4g}"
            for objective, value in zip(self.plan.objectives, self.best.objectives, strict=True)
        )
        verdict = "all requirements hold" if self.holds else "not shown to meet all requirements"
        head = f"RadarDesign of {self.plan.source} after {self.surveys} surveys"
        return f"{head}: {label(self.best.setting)}; {reached}; {verdict}"


def first_count(plan: DesignPlan) -> int:
    """Return the number of settings flown before the first model."""
    return max(2 * len(plan.space.keys) + 2, 8)


# Results of which more is better.
LEAST_IS_WORST = (*MAPPED, "coverage", "min_m", "pd_wire", "pd_obstacle", "warning_s")


def worst(name: str, values: Sequence[float]) -> float:
    """Return the worst of a result's values over several worlds: the least coverage or area, the largest error."""
    if name in LEAST_IS_WORST:
        return min(values)
    return max(values, key=abs)


def standing_of(requirement: Requirement, margins: Float[np.ndarray, " seed"]) -> Standing:
    """Return the standing of a requirement from its margins over several seeds."""
    count, mean = margins.size, float(margins.mean())
    spread = float(margins.std(ddof=1)) if count > 1 else 0.0
    # A requirement on costs alone has one margin, without scatter.
    sure = float(mean > 0)
    return Standing(
        requirement=requirement.text,
        margin=mean,
        spread=spread,
        probability=float(t.cdf(mean / (spread / np.sqrt(count)), count - 1)) if spread > 0 else sure,
        of_one_survey=float(t.cdf(mean / (spread * np.sqrt(1 + 1 / count)), count - 1)) if spread > 0 else sure,
    )
