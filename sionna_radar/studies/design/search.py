"""The search of a radar design: what is flown, and what is learned from it.

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

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import qmc

from sionna_radar.execution.execution import Execution
from sionna_radar.execution.workers import Failure
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.linear_algebra import on_one_thread
from sionna_radar.foundation.randomness import Stream
from sionna_radar.foundation.raster import Raster
from sionna_radar.scenario import Scenario
from sionna_radar.studies.design.plan import (
    RESULTS,
    Checked,
    DesignPlan,
    Observation,
    Standing,
    first_count,
    standing_of,
    worst,
)
from sionna_radar.studies.design.surrogate import Surrogate, flown_probability, improvement, pareto
from sionna_radar.studies.sweep.plan import failure
from sionna_radar.studies.sweep.quantities import QUANTITIES, key_value, quantities_of
from sionna_radar.studies.sweep.settings import Setting, refuse
from sionna_radar.studies.sweep.trial import Trial, fly_trials

# Proposed at once, whatever the number of workers.
BATCH = 4
# Candidates of a proposal: over the whole space, and around each of the best settings.
POOL, NEAR, AROUND = 512, 64, 3
WIDTHS = (0.02, 0.06, 0.2)
DRAWS = 64
# An optimum that is better by less is not flown again.
WORTHWHILE = 0.01
# Share by which the corner of the hypervolume lies beyond the worst of the front.
BEYOND = 0.1

Numbers = dict[str, Float[np.ndarray, "..."]]


class Search:
    """Surveys flown so far, the models of them, and what to fly next."""

    def __init__(self, plan: DesignPlan, execution: Execution) -> None:
        self.plan, self.execution = plan, execution
        self.observations: list[Observation] = []
        self.rng = np.random.default_rng([plan.base.seed, int(Stream.SAMPLES)])
        self.closed: dict[str, dict[str, float] | None] = {}
        self.models: dict[str, Surrogate] = {}
        sampler = qmc.Sobol(len(plan.space.keys), rng=self.rng)
        sampled = plan.space.settings(sampler.random(POOL))
        self.pool = self.possible(sampled)
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
            self.checked = {key: self.checked_design(one.setting) or one for key, one in self.checked.items()}
        if len(good) < 2:
            return
        inputs = self.plan.space.inputs([o.setting for o in good])
        fit = on_one_thread(Surrogate.fit)
        self.models = {name: fit(name, inputs, np.array([o.results[name] for o in good])) for name in self.plan.results}

    # Values

    def possible(self, settings: Sequence[Setting]) -> list[Setting]:
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
        candidates = self.candidates()
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

    def candidates(self) -> list[Setting]:
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
        return [*self.pool, *self.possible(space.settings(np.concatenate(near)))]

    # The final check

    def check(self) -> None:
        """Fly the expected optimum with several seeds, and a better one while surveys are left."""
        while self.left >= 2:
            setting = self._recommended()
            if setting is None:
                break
            self.fly([setting] * min(self.plan.repeat, self.left))
            checked = self.checked_design(setting)
            if checked is None:
                # It fails in flight; the models know by now.
                self.checked.pop(repr(setting), None)
                continue
            self.checked[repr(setting)] = checked

    @on_one_thread
    def _recommended(self) -> Setting | None:
        """Return the setting to be checked next; None if nothing promises to be better than what is."""
        if len(self.plan.objectives) == 2:
            front = self.front()
            if front:
                best = front[nearest_to_ideal([one.objectives for one in front], self.plan)].setting
                return None if repr(best) in self.checked else best
        failed = {repr(o.setting) for o in self.observations if o.reason}
        flown = [o.setting for o in self.observations if not o.reason]
        known = failed | set(self.checked)
        candidates = [s for s in (*self.candidates(), *self.possible(flown)) if repr(s) not in known]
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

    def front(self) -> list[Checked]:
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

    def checked_design(self, setting: Setting, relaxed: Mapping[int, float] | None = None) -> Checked | None:
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


def nearest_to_ideal(points: Sequence[tuple[float, ...]], plan: DesignPlan) -> int:
    """Return the point nearest to the best of both objectives, over the ranges of the front."""
    minimised = np.array(points) * np.array([o.sign for o in plan.objectives])
    size = np.where(np.ptp(minimised, axis=0) > 0, np.ptp(minimised, axis=0), 1.0)
    return int(np.argmin(np.linalg.norm((minimised - minimised.min(axis=0)) / size, axis=1)))
