"""The statement of a radar design: the optimum, and what its parameters and limits do to it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import label as label_runs
from scipy.stats import sobol_indices, uniform

from sionna_radar.foundation.linear_algebra import on_one_thread
from sionna_radar.foundation.raster import Raster
from sionna_radar.studies.design.plan import FLAT, RELAXED, Checked, RadarDesign, Relaxation, Slice
from sionna_radar.studies.design.search import Search, nearest_to_ideal
from sionna_radar.studies.sweep.common_cells import common_rms_m
from sionna_radar.studies.sweep.settings import Setting, label, refuse

SLICE_POINTS = 41
# Designs whose maps are kept.
MAPS = 3
SOBOL_SAMPLES = 256


@on_one_thread
def statement_of(search: Search) -> RadarDesign:
    """Return the design, from what was checked and the models."""
    if not search.checked:
        refuse(f"{search.plan.surveys} are too few to check a design; raise it, or widen --free", "--surveys")
    signs = [o.sign for o in search.plan.objectives]
    front = search.front() if len(signs) == 2 else []
    sure = [c for c in search.checked.values() if c.probability >= search.plan.confidence]
    if front:
        # One that was flown with several seeds, as the last surveys may have moved the front a little.
        flown = [one for one in front if repr(one.setting) in search.checked] or front
        best = flown[nearest_to_ideal([one.objectives for one in flown], search.plan)]
    elif sure:
        best = min(sure, key=lambda c: signs[0] * c.objectives[0])
    else:
        best = max(search.checked.values(), key=lambda c: c.probability)
    others = sorted(
        (c for c in search.checked.values() if c.setting != best.setting),
        key=lambda c: (c.probability < search.plan.confidence, signs[0] * c.objectives[0]),
    )
    if repr(best.setting) in search.checked:  # what was flown, not what the models pool
        best = replace(best, objectives=search.checked[repr(best.setting)].objectives)
    designs = _over_common_cells(search, [best, *others])
    holds = bool(sure or front)
    return RadarDesign(
        plan=search.plan,
        observations=tuple(search.observations),
        best=designs[0],
        holds=holds,
        checked=tuple(designs),
        front=tuple(front),
        maps=_maps(search, designs),
        slices=tuple(_slice(search, best, number, holds=holds) for number in range(len(search.plan.space.keys))),
        relaxations=_relaxations(search, best, holds=holds),
        sensitivity=_sensitivity(search),
        noise={name: model.noise for name, model in search.models.items()},
    )


def _over_common_cells(search: Search, designs: Sequence[Checked]) -> list[Checked]:
    """Return designs with their RMS error over the cells that all of them filled: the worst of all worlds."""
    flown = [search.errors.get(repr(design.setting), []) for design in designs]
    if len([seeds for seeds in flown if seeds]) < 2:
        return list(designs)
    common = [
        common_rms_m([errors[world] for seeds in flown for errors in seeds]) for world in range(len(search.plan.worlds))
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


def _maps(search: Search, designs: Sequence[Checked]) -> tuple[tuple[str, Raster], ...]:
    """Return the height errors of the best designs in the first world, each with the first seed of its check."""
    kept = [design.setting for design in designs if repr(design.setting) in search.errors]
    return tuple((label(setting), search.errors[repr(setting)][0][0]) for setting in kept[:MAPS])


def _slice(search: Search, best: Checked, number: int, *, holds: bool) -> Slice:
    space = search.plan.space
    key, centre = space.keys[number], space.shares([best.setting])[0]
    levels = None if number < len(space.spans) else len(space.listed[number - len(space.spans)].values)
    along = np.linspace(0, 1, SLICE_POINTS) if levels is None else (np.arange(levels) + 0.5) / levels
    share = np.tile(centre, (len(along), 1))
    share[:, number] = along
    on_slice = [{**best.setting, key: s[key]} for s in space.settings(share)]
    settings = search.possible([*on_slice, best.setting])
    settings = [settings[k] for k in np.argsort(space.shares(settings)[:, number], kind="stable")]
    inputs = space.inputs(settings)
    chance = search.probability(search.draws(settings), len(settings)) * search.flyable(settings)
    objective = search.objectives(search.expected(settings), len(settings))[:, 0]
    results = {}
    for name, model in search.models.items():
        mean, sigma = model.moments(inputs)
        results[name] = model.result(mean), (model.result(mean + sigma) - model.result(mean - sigma)) / 2
    tolerance, at_end = tuple[Any, ...](), False
    if objective.shape[1] == 1 and holds:
        at = [repr(setting) for setting in settings].index(repr(best.setting))
        within = _within_tolerance(search, best, settings, objective[:, 0], chance, at)
        if levels is None:
            run, _ = label_runs(within)
            within = within & (run == run[at])
            at_end = _at_end(centre[number], objective[:, 0], chance, at)
        tolerance = tuple(s[key] for s, kept in zip(settings, within, strict=True) if kept)
    return Slice(
        key=key,
        values=tuple(setting[key] for setting in settings),
        objectives=objective * np.array([o.sign for o in search.plan.objectives]),
        results=results,
        holds=chance,
        tolerance=tolerance,
        at_end=at_end,
    )


def _within_tolerance(
    search: Search,
    best: Checked,
    settings: Sequence[Setting],
    objective: Float[np.ndarray, " n"],
    chance: Float[np.ndarray, " n"],
    at: int,
) -> Bool[np.ndarray, " n"]:
    """Return the settings that are as good as the optimum, by the models and by what was flown with several seeds.

    Flown designs that differ from the optimum in other keys count where those agree to within a step of the slice.
    """
    printed = search.plan.objectives[0].sign * best.objectives[0]
    flat = FLAT * abs(printed)
    within = (np.abs(objective - objective[at]) <= flat) & (chance >= search.plan.confidence)
    shares = search.plan.space.shares(settings)
    for design in search.checked.values():
        near = np.abs(shares - search.plan.space.shares([design.setting])[0]).max(axis=1) <= 0.5 / (SLICE_POINTS - 1)
        off = abs(search.plan.objectives[0].sign * design.objectives[0] - printed) > flat
        if design.setting != best.setting and (off or design.probability < search.plan.confidence):
            within[near] = False
    within[at] = True
    return np.asarray(within)


def _at_end(fraction: float, objective: Float[np.ndarray, " n"], chance: Float[np.ndarray, " n"], at: int) -> bool:
    """Return True if an optimum lies at an end of its range, and the objective improves all the way toward it."""
    step = 1 / (SLICE_POINTS - 1)
    if min(fraction, 1 - fraction) > step:
        return False
    end, inward = (0, 1) if fraction <= step else (len(objective) - 1, -1)
    # Over a tenth of the range, beyond what a rounded value changes.
    inner = min(max(end + inward * SLICE_POINTS // 10, 0), len(objective) - 1)
    towards = objective[min(inner, end) : max(inner, end) + 1][::-inward]
    return bool((np.diff(towards) < 0).all() and len(towards) > 1 and chance[at] >= 0.5)


def _relaxations(search: Search, best: Checked, *, holds: bool) -> tuple[Relaxation, ...]:
    if len(search.plan.objectives) != 1:
        return ()
    sign = search.plan.objectives[0].sign
    candidates = [*search.candidates(), best.setting]
    values = search.draws(candidates)
    objective = search.objectives(search.expected(candidates), len(candidates))[:, 0, 0]
    flyable = search.flyable(candidates) >= 0.5
    printed = sign * best.objectives[0]

    def least(relaxed: Mapping[int, float]) -> float:
        sure = flyable & (search.probability(values, len(candidates), relaxed) >= search.plan.confidence)
        sure[-1] |= holds  # the optimum, which was flown
        return float(objective[sure].min()) if sure.any() else np.nan

    def expected(number: int, by: float) -> float:
        """Return the optimum's objective with a limit relaxed: that of the models, and what was flown."""
        if not holds:
            return least({number: by})
        flown = [
            sign * design.objectives[0]
            for design in (search.checked_design(one.setting, {number: by}) for one in search.checked.values())
            if design is not None and design.probability >= search.plan.confidence
        ]
        return min([printed + least({number: by}) - now, *flown])

    now, found = least({}), list[Relaxation]()
    for number, requirement in enumerate(search.plan.requirements):
        relaxed, without = expected(number, RELAXED), expected(number, np.inf)
        saving = float((printed - relaxed) / abs(printed)) if holds and printed else np.nan
        limits = {"relaxed": sign * relaxed, "without": sign * min(without, relaxed)}
        found.append(Relaxation(requirement=requirement.text, saving=saving, **limits))
    return tuple(found)


def _sensitivity(search: Search) -> dict[str, dict[str, float]]:
    """Return total-order Sobol indices over the free ranges (Sobol' 2001; Saltelli et al. 2010), by the models."""
    keys, space = search.plan.space.keys, search.plan.space
    texts = [o.expression.text for o in search.plan.objectives]
    names = [*search.models, *(text for text in texts if text not in search.models)]

    def at_fractions(fraction: Float[np.ndarray, "key n"]) -> Float[np.ndarray, "name n"]:
        """Return predictions and objectives at fractions of the parameters' ranges."""
        settings = space.settings(fraction.T)
        inputs = space.inputs(settings)
        rows = {name: model.moments(inputs)[0] for name, model in search.models.items()}
        reached = search.objectives(search.expected(settings), len(settings))[:, 0]
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
