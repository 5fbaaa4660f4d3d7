"""The search of a radar design: what is flown, what is learned from it, and what it says of the optimum.

Costs in closed form are known without a survey. The errors of a survey are learned from flown settings as Gaussian
processes with the noise of seeds (`surrogate`). The next settings are those with the largest expected improvement of
the objective times the probability that all requirements hold (Schonlau, Welch & Jones 1998; Gardner et al. 2014), or
with two objectives, of the hypervolume of their Pareto front (Emmerich et al. 2006), over draws of the models and exact
costs; a batch is filled as if each proposed setting had come out as expected (Ginsbourger et al. 2010). Proposals
depend on finished surveys and the seed only: neither on the number of workers nor on interrupts.

In the end the proposed optimum is flown with seeds of its own. A requirement is met with the probability by Student's
t distribution of its margins over these: that their mean over all seeds is positive, and that of one further survey is.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import qmc, sobol_indices, uniform

from sionna_radar.execution.execution import Execution
from sionna_radar.execution.workers import Failure
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.linear_algebra import on_one_thread
from sionna_radar.foundation.progress import stage
from sionna_radar.foundation.randomness import Stream
from sionna_radar.foundation.raster import Raster
from sionna_radar.scenario import Scenario
from sionna_radar.studies.design.plan import (
    FLAT,
    RELAXED,
    RESULTS,
    Checked,
    DesignPlan,
    Observation,
    RadarDesign,
    Relaxation,
    Slice,
    Standing,
    first_count,
    standing_of,
    worst,
)
from sionna_radar.studies.design.surrogate import Surrogate, flown_probability, improvement, pareto
from sionna_radar.studies.sweep.common_cells import common_rms_m
from sionna_radar.studies.sweep.plan import failure
from sionna_radar.studies.sweep.quantities import QUANTITIES, key_value, quantities_of
from sionna_radar.studies.sweep.settings import Setting, label, refuse
from sionna_radar.studies.sweep.trial import Trial, fly_trials

# Proposed at once, whatever the number of workers.
BATCH = 4
# Candidates of a proposal: over the whole space, and around each of the best settings.
POOL, NEAR, AROUND = 512, 64, 3
WIDTHS = (0.02, 0.06, 0.2)
DRAWS = 64
# An optimum that is better by less is not flown again.
WORTHWHILE = 0.01
SLICE_POINTS = 41
# Designs whose maps are kept.
MAPS = 3
SOBOL_SAMPLES = 256
# Share by which the corner of the hypervolume lies beyond the worst of the front.
BEYOND = 0.1

Numbers = dict[str, Float[np.ndarray, "..."]]


def run_design(plan: DesignPlan, *, execution: Execution | None = None) -> RadarDesign:
    """Search for the best design, check it with several seeds, and return it with its standing.

    Parameters
    ----------
    plan:
        From `plan_design`.
    execution:
        As for `sionna_radar.run`; each survey is a task.

    Returns
    -------
    The best design, whether it meets its requirements, and the other designs that were checked.

    Raises
    ------
    ScenarioError
        No setting could be flown.
    BackendError, WorkerError
        As for `run_sweep`.

    Examples
    --------
    >>> from sionna_radar.studies.design import plan_design
    >>> short = {"platform.length_m": 6.0, "terrain.spacing_m": 2.0, "tracing.paths_per_pulse": 32}
    >>> beam = ["radar.antenna.beamwidth_deg=2:6"]
    >>> asked = {"minimise": ["aperture_m"], "require": ["rms_m < 1"], "surveys": 12, "repeat": 2}
    >>> run_design(plan_design("hills", beam, overrides=short, **asked)).holds
    True
    """
    execution = execution or Execution()
    search = _Search(plan, execution)
    with execution.reported(), stage("surveys", plan.surveys):
        search.explore()
        search.check()
    return search.result()


class _Search:
    """Surveys flown so far, the models of them, and what to fly next."""

    def __init__(self, plan: DesignPlan, execution: Execution) -> None:
        self.plan, self.execution = plan, execution
        self.observations: list[Observation] = []
        self.rng = np.random.default_rng([plan.base.seed, int(Stream.SAMPLES)])
        self.closed: dict[str, dict[str, float] | None] = {}
        self.models: dict[str, Surrogate] = {}
        sampler = qmc.Sobol(len(plan.space.keys), rng=self.rng)
        sampled = plan.space.settings(sampler.random(POOL))
        self.pool = self._possible(sampled)
        for axis in plan.space.listed:
            possible, tried = ([s[axis.key] for s in some] for some in (self.pool, sampled))
            if never := [value for value in axis.values if value in tried and value not in possible]:
                refuse(f"{axis.key} = {never[0]} cannot be flown with any of the other values; remove it", "--free")
        self.normal = self.rng.standard_normal((len(plan.results), DRAWS))
        self.checked: dict[str, Checked] = {}
        # Height errors over lit cells of each design flown with several seeds, seed by seed, by world.
        self.errors: dict[str, list[tuple[Raster, ...]]] = {}

    # Flights

    @property
    def left(self) -> int:
        """Settings that can still be flown."""
        return (self.plan.surveys - len(self.observations) * len(self.plan.worlds)) // len(self.plan.worlds)

    def fly(self, settings: Sequence[Setting]) -> None:
        """Fly settings, each with the next seed, in all worlds."""
        keys: dict[int, list[str]] = {}
        flown: dict[str, Scenario] = {}
        refused: dict[int, str] = {}
        first = len(self.observations)
        for number, setting in enumerate(settings):
            try:
                scenarios = self.plan.scenarios(setting, self.plan.base.seed + first + number)
            except (ScenarioError, InputFileError) as error:
                refused[number] = str(error)
                continue
            documents = {scenario.model_dump_json(): scenario for scenario in scenarios}
            keys[number], flown = list(documents), flown | documents
        fixed = {"block_size": self.execution.block_size, "keep_maps": False}
        tasks = {key: {"scenario": key, **fixed} for key in flown}
        done = dict(fly_trials(self.execution, tasks))
        for number, setting in enumerate(settings):
            seed, reason, results = self.plan.base.seed + first + number, refused.get(number, ""), {}
            outcomes = [(flown[key], done[key]) for key in keys.get(number, ())]
            for scenario, outcome in outcomes:
                if isinstance(outcome, Failure):
                    reason = reason or failure(outcome, scenario, 0)
            if not reason:
                trials = [outcome for _, outcome in outcomes if isinstance(outcome, Trial)]
                results = {name: worst(name, [trial.statistic(name) for trial in trials]) for name in RESULTS}
                if missing := [name for name in self.plan.results if not np.isfinite(results[name])]:
                    why = [text for trial in trials for text in trial.warnings]
                    unfilled = "no cell of the map has a height, or none it asks for"
                    reason = f"{missing[0]} is undefined: {next(iter(why), unfilled)}"
                errors = tuple(trial.maps["error"] for trial in trials if "error" in trial.maps)
                if settings.count(setting) > 1 and len(errors) == len(self.plan.worlds):
                    self.errors.setdefault(repr(setting), []).append(errors)
            method = outcomes[0][0].dem.map_method if outcomes else ""
            self.observations.append(
                Observation(setting=setting, seed=seed, results=results, method=method, reason=reason)
            )
        self._learn()

    def _learn(self) -> None:
        good = [o for o in self.observations if not o.reason]
        if self.plan.keeps_swath and good:
            self.plan = self.plan.keeping_swath(max(o.results["coverage_of_swath"] for o in good))
            self.checked = {key: self._checked(one.setting) or one for key, one in self.checked.items()}
        if len(good) < 2:
            return
        inputs = self.plan.space.inputs([o.setting for o in good])
        fit = on_one_thread(Surrogate.fit)
        self.models = {name: fit(name, inputs, np.array([o.results[name] for o in good])) for name in self.plan.results}

    # Values

    def _possible(self, settings: Sequence[Setting]) -> list[Setting]:
        """Return the distinct settings whose scenarios are valid."""
        distinct = {repr(setting): setting for setting in settings}
        return [setting for setting in distinct.values() if self._closed(setting) is not None]

    def _closed(self, setting: Setting) -> dict[str, float] | None:
        """Return quantities and keys of a setting by name; None if its scenario is refused, or one is undefined."""
        key = repr(setting)
        if key not in self.closed:
            try:
                scenario = self.plan.scenarios(setting)[0]
                names = [name for name in self.plan.names if name not in RESULTS]
                known = quantities_of(scenario, self.plan.area, [name for name in names if name in QUANTITIES])
                values = {name: known[name] if name in known else key_value(scenario, name) for name in names}
                self.closed[key] = values if all(map(np.isfinite, values.values())) else None
            except (ScenarioError, InputFileError):
                self.closed[key] = None
        return self.closed[key]

    def values(self, settings: Sequence[Setting], results: Numbers) -> Numbers:
        """Return all named values, (n, 1) or as the results (n, draw)."""
        closed = [self._closed(setting) or {} for setting in settings]
        names = [name for name in self.plan.names if name not in RESULTS]
        values = {name: np.array([[known.get(name, np.nan)] for known in closed]) for name in names} | results
        needed = all(name in values for name in self.plan.costs.needs)
        return values | (self.plan.costs.totals(values) if needed else {})

    def objectives(self, values: Numbers, settings: int) -> Float[np.ndarray, "n draw objective"]:
        """Return the objectives as they are minimised."""
        found = [o.sign * o.expression.value(values) for o in self.plan.objectives]
        width = max(value.shape[-1] if value.ndim else 1 for value in found)
        return np.stack([np.broadcast_to(value, (settings, width)) for value in found], axis=-1)

    def margins(self, values: Numbers, relaxed: Mapping[int, float] | None = None) -> list[Float[np.ndarray, "n draw"]]:
        """Return the margin of each requirement; those relaxed infinitely are left out."""
        given = relaxed or {}
        return [
            np.atleast_2d(requirement.margin(values, given.get(number, 0.0)))
            for number, requirement in enumerate(self.plan.requirements)
            if np.isfinite(given.get(number, 0.0))
        ]

    def draws(
        self, settings: Sequence[Setting], models: Mapping[str, Surrogate] | None = None, seeds: float = np.inf
    ) -> Numbers:
        """Return all values with possible results of each setting: means over a number of seeds."""
        inputs, models = self.plan.space.inputs(settings), models or self.models
        results = {
            name: models[name].draws(inputs, z, seeds) for name, z in zip(self.plan.results, self.normal, strict=True)
        }
        return self.values(settings, results)

    def expected(self, settings: Sequence[Setting]) -> Numbers:
        """Return all values with the most probable results."""
        inputs = self.plan.space.inputs(settings)
        return self.values(settings, {name: model.mean(inputs)[:, None] for name, model in self.models.items()})

    def probability(
        self, values: Numbers, settings: int, relaxed: Mapping[int, float] | None = None
    ) -> Float[np.ndarray, " n"]:
        """Return the probability that all requirements hold, over the draws."""
        return np.asarray(self.holds(values, settings, relaxed).mean(axis=1))

    def holds(
        self, values: Numbers, settings: int, relaxed: Mapping[int, float] | None = None
    ) -> Bool[np.ndarray, "n draw"]:
        """Return True where all requirements hold in each draw."""
        return np.logical_and.reduce(
            np.broadcast_arrays(np.ones((settings, 1), dtype=bool), *(m > 0 for m in self.margins(values, relaxed)))
        )

    def flyable(self, settings: Sequence[Setting]) -> Float[np.ndarray, " n"]:
        """Return the probability of each setting to be flown."""
        flown = [not o.reason for o in self.observations]
        inputs = self.plan.space.inputs([o.setting for o in self.observations])
        return flown_probability(inputs, flown, self.plan.space.inputs(settings))

    # Proposals

    def explore(self) -> None:
        """Fly the first settings, and then what promises most, up to the share kept for the final check."""
        plan = self.plan
        self.fly(self.pool[: min(first_count(plan), len(self.pool))])
        twice = len(plan.objectives) == 1 and self.left >= 4 * plan.repeat
        kept = 2 * plan.repeat if twice else plan.repeat
        while self.left > kept:
            if len(self.models) < len(plan.results):
                untried = self.pool[len(self.observations) : len(self.observations) + BATCH]
                if not untried:
                    break
                self.fly(untried[: self.left - kept])
                continue
            self.fly(self._proposals(min(BATCH, self.left - kept)))
        if not self.models:
            reasons = {o.reason for o in self.observations}
            refuse(f"no setting could be flown: {next(iter(reasons), 'all scenarios are refused')}", "--free")

    @on_one_thread
    def _proposals(self, count: int) -> list[Setting]:
        candidates = self._candidates()
        good = [o for o in self.observations if not o.reason]
        inputs = self.plan.space.inputs([o.setting for o in good])
        values = {name: np.array([o.results[name] for o in good]) for name in self.plan.results}
        models, proposed = dict(self.models), list[Setting]()
        chance = self.flyable(candidates)
        for _ in range(count):
            flown = [*(o.setting for o in good), *proposed]
            score = chance * self._scores(candidates, flown, models)
            best = candidates[int(np.argmax(score))]
            proposed.append(best)
            at = self.plan.space.inputs([best])
            inputs = np.concatenate([inputs, at])
            for name, model in models.items():
                values[name] = np.append(values[name], model.mean(at))
                models[name] = Surrogate.fit(name, inputs, values[name], model.process.kernel_)
        return proposed

    def _scores(
        self, candidates: Sequence[Setting], flown: Sequence[Setting], models: Mapping[str, Surrogate]
    ) -> Float[np.ndarray, " n"]:
        """Return the expected improvement with all requirements met; or how likely they are, if none is known to be."""
        values = self.draws(candidates, models)
        holds = self.holds(values, len(candidates))
        objectives = self.objectives(values, len(candidates))
        reached, met = self._reached(flown, models)
        if not met.any():
            return np.asarray(holds.mean(axis=1))
        if len(self.plan.objectives) == 2:
            low, high = reached[met].min(axis=0), reached.max(axis=0)
            size = np.where(high > low, high - low, 1.0)
            objectives, reached = (objectives - low) / size, (reached - low) / size
            reached = np.concatenate([np.full((1, 2), 1.0 + BEYOND), reached[met]])
        else:
            reached = reached[met]
        gain = np.nan_to_num((improvement(objectives, reached) * holds).mean(axis=1))
        # Where nothing promises an improvement, the least known setting tells most.
        inputs = self.plan.space.inputs(candidates)
        unknown = sum(model.moments(inputs)[1] / model.scale for model in models.values())
        return gain + 1e-9 * max(float(gain.max()), 1.0) * unknown

    def _reached(
        self, flown: Sequence[Setting], models: Mapping[str, Surrogate]
    ) -> tuple[Float[np.ndarray, "n objective"], Bool[np.ndarray, " n"]]:
        """Return the expected objectives of flown settings, and whether they more likely meet all requirements."""
        inputs = self.plan.space.inputs(flown)
        values = self.values(flown, {name: model.mean(inputs)[:, None] for name, model in models.items()})
        met = self.probability(self.draws(flown, models), len(flown)) >= 0.5
        return self.objectives(values, len(flown))[:, 0], met

    def _candidates(self) -> list[Setting]:
        """Return settings over the whole space, and around the best flown ones."""
        space, flown = self.plan.space, [o.setting for o in self.observations if not o.reason]
        objective, met = self._reached(flown, self.models)
        chance = self.probability(self.draws(flown), len(flown))
        rank = np.lexsort((objective[:, 0], -chance if not met.any() else ~met))
        if len(self.plan.objectives) == 2 and met.any():
            on_front = {tuple(point) for point in pareto(objective[met])}
            rank = np.array([k for k in rank if met[k] and tuple(objective[k]) in on_front])
            rank = rank[np.linspace(0, len(rank) - 1, min(3 * AROUND, len(rank))).astype(int)]
        best = space.shares([flown[k] for k in rank[: 3 * AROUND if len(self.plan.objectives) == 2 else AROUND]])
        near = [space.near(np.repeat(best, NEAR // 2, axis=0), width, self.rng) for width in WIDTHS]
        return [*self.pool, *self._possible(space.settings(np.concatenate(near)))]

    # The final check

    def check(self) -> None:
        """Fly the expected optimum with several seeds, and a better one while surveys are left."""
        while self.left >= 2:
            setting = self._recommended()
            if setting is None:
                break
            self.fly([setting] * min(self.plan.repeat, self.left))
            checked = self._checked(setting)
            if checked is None:
                # It fails in flight; the models know by now.
                self.checked.pop(repr(setting), None)
                continue
            self.checked[repr(setting)] = checked

    @on_one_thread
    def _recommended(self) -> Setting | None:
        """Return the setting to be checked next; None if nothing promises to be better than what is."""
        if len(self.plan.objectives) == 2:
            front = self._front()
            if front:
                best = front[_nearest_to_ideal([one.objectives for one in front], self.plan)].setting
                return None if repr(best) in self.checked else best
        failed = {repr(o.setting) for o in self.observations if o.reason}
        flown = [o.setting for o in self.observations if not o.reason]
        known = failed | set(self.checked)
        candidates = [s for s in (*self._candidates(), *self._possible(flown)) if repr(s) not in known]
        if not candidates:
            return None
        standing = [c for c in self.checked.values() if c.probability >= self.plan.confidence]
        # The check will scatter, too, and one that has failed asks for more of a margin; beside a design that stands
        # what is left is worth a bolder one.
        seeds = np.inf if standing else self.plan.repeat / (2 + len(self.checked))
        chance = self.probability(self.draws(candidates, seeds=seeds), len(candidates)) * self.flyable(candidates)
        sure = chance >= (0.5 if standing else self.plan.confidence)
        if len(self.plan.objectives) == 2 or not sure.any():
            return None if self.checked else candidates[int(np.argmax(chance))]
        objective = self.objectives(self.expected(candidates), len(candidates))[:, 0, 0]
        least = objective[sure].min()
        # Of designs that cost the same the surest.
        equal = sure & (objective <= least + WORTHWHILE * abs(least))
        best_of_all = int(np.argmax(np.where(equal, chance, -1.0)))
        reached = min((self.plan.objectives[0].sign * c.objectives[0] for c in standing), default=np.inf)
        if standing and reached - objective[best_of_all] <= WORTHWHILE * abs(reached):
            return None
        return candidates[best_of_all]

    def _front(self) -> list[Checked]:
        """Return the Pareto front of flown settings by the models, which pool all surveys; by the first objective."""
        flown = list({repr(o.setting): o.setting for o in self.observations if not o.reason}.values())
        values = self.draws(flown)
        chance = [
            self.checked[repr(s)].probability if repr(s) in self.checked else c
            for s, c in zip(flown, self.probability(values, len(flown)), strict=True)
        ]
        sure = np.array(chance) >= self.plan.confidence
        if not sure.any():
            return []
        expected = self.expected(flown)
        objective = self.objectives(expected, len(flown))[:, 0]
        kept = {tuple(point) for point in pareto(objective[sure])}
        found = []
        for number in np.flatnonzero(sure):
            if tuple(objective[number]) not in kept:
                continue
            reached = tuple(float(o.sign * v) for o, v in zip(self.plan.objectives, objective[number], strict=True))
            checked = self.checked.get(repr(flown[number]))
            found.append(replace(checked or self._expected_standing(flown[number]), objectives=reached))
        return sorted(found, key=lambda one: one.objectives[0])

    def _expected_standing(self, setting: Setting) -> Checked:
        values, scenario = self.draws([setting]), self.plan.scenarios(setting)[0]
        standing = tuple(
            Standing(
                requirement=requirement.text,
                margin=float(margin.mean()),
                spread=float(margin.std()),
                probability=float((margin > 0).mean()),
                of_one_survey=float("nan"),
            )
            for requirement, margin in zip(self.plan.requirements, self.margins(values), strict=True)
        )
        known = {name: float(np.mean(value)) for name, value in self.expected([setting]).items()}
        return Checked(
            setting=setting,
            scenario=scenario,
            seeds=sum(o.setting == setting and not o.reason for o in self.observations),
            objectives=(),
            values=quantities_of(scenario, self.plan.area) | known,
            spread={},
            standing=standing,
        )

    def _checked(self, setting: Setting, relaxed: Mapping[int, float] | None = None) -> Checked | None:
        """Return the standing of a setting on all that is not relaxed infinitely; None with fewer than two surveys."""
        flown = [o for o in self.observations if o.setting == setting and not o.reason]
        if len(flown) < 2:
            return None
        results = {name: np.array([[o.results[name] for o in flown]]) for name in RESULTS}
        used = {name: results[name] for name in self.plan.results}
        values = self.values([setting], used)
        given = relaxed or {}
        asked = [r for n, r in enumerate(self.plan.requirements) if np.isfinite(given.get(n, 0.0))]
        standing = tuple(
            standing_of(requirement, margin[0])
            for requirement, margin in zip(asked, self.margins(values, given), strict=True)
        )
        found = self.objectives(values, 1)[0].mean(axis=0)
        scenario = self.plan.scenarios(setting)[0]
        known = {name: float(np.mean(value)) for name, value in values.items()}
        return Checked(
            setting=setting,
            scenario=scenario,
            seeds=len(flown),
            objectives=tuple(float(o.sign * v) for o, v in zip(self.plan.objectives, found, strict=True)),
            values=quantities_of(scenario, self.plan.area) | known | {n: float(r.mean()) for n, r in results.items()},
            spread={name: float(np.std(value, ddof=1)) for name, value in results.items()},
            standing=standing,
        )

    # The statement

    @on_one_thread
    def result(self) -> RadarDesign:
        """Return the design, from what was checked and the models."""
        if not self.checked:
            refuse(f"{self.plan.surveys} are too few to check a design; raise it, or widen --free", "--surveys")
        signs = [o.sign for o in self.plan.objectives]
        front = self._front() if len(signs) == 2 else []
        sure = [c for c in self.checked.values() if c.probability >= self.plan.confidence]
        if front:
            # One that was flown with several seeds, as the last surveys may have moved the front a little.
            flown = [one for one in front if repr(one.setting) in self.checked] or front
            best = flown[_nearest_to_ideal([one.objectives for one in flown], self.plan)]
        elif sure:
            best = min(sure, key=lambda c: signs[0] * c.objectives[0])
        else:
            best = max(self.checked.values(), key=lambda c: c.probability)
        others = sorted(
            (c for c in self.checked.values() if c.setting != best.setting),
            key=lambda c: (c.probability < self.plan.confidence, signs[0] * c.objectives[0]),
        )
        if repr(best.setting) in self.checked:  # what was flown, not what the models pool
            best = replace(best, objectives=self.checked[repr(best.setting)].objectives)
        designs = self._over_common_cells([best, *others])
        holds = bool(sure or front)
        return RadarDesign(
            plan=self.plan,
            observations=tuple(self.observations),
            best=designs[0],
            holds=holds,
            checked=tuple(designs),
            front=tuple(front),
            maps=self._maps(designs),
            slices=tuple(self._slice(best, number, holds=holds) for number in range(len(self.plan.space.keys))),
            relaxations=self._relaxations(best, holds=holds),
            sensitivity=self._sensitivity(),
            noise={name: model.noise for name, model in self.models.items()},
        )

    def _over_common_cells(self, designs: Sequence[Checked]) -> list[Checked]:
        """Return designs with their RMS error over the cells that all of them filled: the worst of all worlds."""
        flown = [self.errors.get(repr(design.setting), []) for design in designs]
        if len([seeds for seeds in flown if seeds]) < 2:
            return list(designs)
        common = [
            common_rms_m([errors[world] for seeds in flown for errors in seeds])
            for world in range(len(self.plan.worlds))
        ]
        if any(errors is None for errors in common):
            return list(designs)
        rms_m = np.max([errors for errors in common if errors is not None], axis=0)
        first, found = 0, list[Checked]()
        for design, seeds in zip(designs, flown, strict=True):
            own = {"common_rms_m": float(rms_m[first : first + len(seeds)].mean())} if seeds else {}
            found.append(replace(design, values=design.values | own))
            first += len(seeds)
        return found

    def _maps(self, designs: Sequence[Checked]) -> tuple[tuple[str, Raster], ...]:
        """Return the height errors of the best designs in the first world, each with the first seed of its check."""
        kept = [design.setting for design in designs if repr(design.setting) in self.errors]
        return tuple((label(setting), self.errors[repr(setting)][0][0]) for setting in kept[:MAPS])

    def _slice(self, best: Checked, number: int, *, holds: bool) -> Slice:
        space = self.plan.space
        key, centre = space.keys[number], space.shares([best.setting])[0]
        levels = None if number < len(space.spans) else len(space.listed[number - len(space.spans)].values)
        along = np.linspace(0, 1, SLICE_POINTS) if levels is None else (np.arange(levels) + 0.5) / levels
        share = np.tile(centre, (len(along), 1))
        share[:, number] = along
        on_slice = [{**best.setting, key: s[key]} for s in space.settings(share)]
        settings = self._possible([*on_slice, best.setting])
        settings = [settings[k] for k in np.argsort(space.shares(settings)[:, number], kind="stable")]
        inputs = space.inputs(settings)
        chance = self.probability(self.draws(settings), len(settings)) * self.flyable(settings)
        objective = self.objectives(self.expected(settings), len(settings))[:, 0]
        results = {}
        for name, model in self.models.items():
            mean, sigma = model.moments(inputs)
            results[name] = model.result(mean), (model.result(mean + sigma) - model.result(mean - sigma)) / 2
        tolerance, at_end = tuple[Any, ...](), False
        if objective.shape[1] == 1 and holds:
            at = [repr(setting) for setting in settings].index(repr(best.setting))
            within = self._within_tolerance(best, settings, objective[:, 0], chance, at)
            if levels is None:
                within = _joined(within, at)
                at_end = self._at_end(centre[number], objective[:, 0], chance, at)
            tolerance = tuple(s[key] for s, kept in zip(settings, within, strict=True) if kept)
        return Slice(
            key=key,
            values=tuple(setting[key] for setting in settings),
            objectives=objective * np.array([o.sign for o in self.plan.objectives]),
            results=results,
            holds=chance,
            tolerance=tolerance,
            at_end=at_end,
        )

    def _within_tolerance(
        self,
        best: Checked,
        settings: Sequence[Setting],
        objective: Float[np.ndarray, " n"],
        chance: Float[np.ndarray, " n"],
        at: int,
    ) -> Bool[np.ndarray, " n"]:
        """Return the settings that are as good as the optimum, by the models and by what was flown with several seeds.

        Flown designs that differ from the optimum in other keys count where those agree to within a step of the slice.
        """
        printed = self.plan.objectives[0].sign * best.objectives[0]
        flat = FLAT * abs(printed)
        within = (np.abs(objective - objective[at]) <= flat) & (chance >= self.plan.confidence)
        shares = self.plan.space.shares(settings)
        for design in self.checked.values():
            near = np.abs(shares - self.plan.space.shares([design.setting])[0]).max(axis=1) <= 0.5 / (SLICE_POINTS - 1)
            off = abs(self.plan.objectives[0].sign * design.objectives[0] - printed) > flat
            if design.setting != best.setting and (off or design.probability < self.plan.confidence):
                within[near] = False
        within[at] = True
        return np.asarray(within)

    def _at_end(
        self, fraction: float, objective: Float[np.ndarray, " n"], chance: Float[np.ndarray, " n"], at: int
    ) -> bool:
        """Return True if an optimum lies at an end of its range, and the objective improves all the way toward it."""
        step = 1 / (SLICE_POINTS - 1)
        if min(fraction, 1 - fraction) > step:
            return False
        end, inward = (0, 1) if fraction <= step else (len(objective) - 1, -1)
        # Over a tenth of the range, beyond what a rounded value changes.
        inner = min(max(end + inward * SLICE_POINTS // 10, 0), len(objective) - 1)
        towards = objective[min(inner, end) : max(inner, end) + 1][::-inward]
        return bool((np.diff(towards) < 0).all() and len(towards) > 1 and chance[at] >= 0.5)

    def _relaxations(self, best: Checked, *, holds: bool) -> tuple[Relaxation, ...]:
        if len(self.plan.objectives) != 1:
            return ()
        sign = self.plan.objectives[0].sign
        candidates = [*self._candidates(), best.setting]
        values = self.draws(candidates)
        objective = self.objectives(self.expected(candidates), len(candidates))[:, 0, 0]
        flyable = self.flyable(candidates) >= 0.5
        printed = sign * best.objectives[0]

        def least(relaxed: Mapping[int, float]) -> float:
            sure = flyable & (self.probability(values, len(candidates), relaxed) >= self.plan.confidence)
            sure[-1] |= holds  # the optimum, which was flown
            return float(objective[sure].min()) if sure.any() else np.nan

        def expected(number: int, by: float) -> float:
            """Return the optimum's objective with a limit relaxed: that of the models, and what was flown."""
            if not holds:
                return least({number: by})
            flown = [
                sign * design.objectives[0]
                for design in (self._checked(one.setting, {number: by}) for one in self.checked.values())
                if design is not None and design.probability >= self.plan.confidence
            ]
            return min([printed + least({number: by}) - now, *flown])

        now, found = least({}), list[Relaxation]()
        for number, requirement in enumerate(self.plan.requirements):
            relaxed, without = expected(number, RELAXED), expected(number, np.inf)
            saving = float((printed - relaxed) / abs(printed)) if holds and printed else np.nan
            limits = {"relaxed": sign * relaxed, "without": sign * min(without, relaxed)}
            found.append(Relaxation(requirement=requirement.text, saving=saving, **limits))
        return tuple(found)

    def _sensitivity(self) -> dict[str, dict[str, float]]:
        """Return total-order Sobol indices over the free ranges (Sobol' 2001; Saltelli et al. 2010), by the models."""
        keys, space = self.plan.space.keys, self.plan.space
        texts = [o.expression.text for o in self.plan.objectives]
        names = [*self.models, *(text for text in texts if text not in self.models)]

        def at_fractions(fraction: Float[np.ndarray, "key n"]) -> Float[np.ndarray, "name n"]:
            """Return predictions and objectives at fractions of the parameters' ranges."""
            settings = space.settings(fraction.T)
            inputs = space.inputs(settings)
            rows = {name: model.moments(inputs)[0] for name, model in self.models.items()}
            reached = self.objectives(self.expected(settings), len(settings))[:, 0]
            rows |= {text: reached[:, k] for k, text in enumerate(texts) if text not in rows}
            table = np.array([rows[name] for name in names])
            known = np.isfinite(table)
            middle = [row[k].mean() if k.any() else 0.0 for row, k in zip(table, known, strict=True)]
            # Twice, as SciPy 1.17 fails at a single output of a single parameter.
            return np.tile(np.where(known, table, np.array(middle)[:, None]), (2, 1))

        found = sobol_indices(
            func=at_fractions, n=SOBOL_SAMPLES, dists=[uniform(0, 1)] * len(keys), rng=np.random.default_rng(0)
        )
        total = np.clip(np.nan_to_num(found.total_order), 0.0, 1.0).reshape(2 * len(names), len(keys))[: len(names)]
        return {
            name: {key: float(index) for key, index in zip(keys, row, strict=True)}
            for name, row in zip(names, total, strict=True)
        }


def _joined(within: Bool[np.ndarray, " n"], at: int) -> Bool[np.ndarray, " n"]:
    """Return the places that are joined to one of them without a gap."""
    kept = np.zeros_like(within)
    for step in (-1, 1):
        place = at
        while 0 <= place < len(within) and within[place]:
            kept[place] = True
            place += step
    return kept


def _nearest_to_ideal(points: Sequence[tuple[float, ...]], plan: DesignPlan) -> int:
    """Return the point nearest to the best of both objectives, over the ranges of the front."""
    minimised = np.array(points) * np.array([o.sign for o in plan.objectives])
    size = np.where(np.ptp(minimised, axis=0) > 0, np.ptp(minimised, axis=0), 1.0)
    return int(np.argmin(np.linalg.norm((minimised - minimised.min(axis=0)) / size, axis=1)))
