"""Ranking of the settings of a study: by an expression, by requirements, and by Pareto's order."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.stats import ttest_ind

from sionna_radar.studies.sweep.expressions import (
    Expression,
    Requirement,
    check_consistent,
    check_names,
    parse_expression,
    parse_requirement,
)
from sionna_radar.studies.sweep.quantities import QUANTITIES, key_value, quantities_of
from sionna_radar.studies.sweep.study import Case, Sweep
from sionna_radar.studies.sweep.trial import STATISTICS

# Probability of a difference by chance alone above which two settings are not told apart.
UNDECIDED = 0.05
# Closed-form columns of every table of settings.
COLUMNS = ("aperture_m", "swath_m", "area_per_hour_km2", "line_gap_m")


@dataclass(frozen=True, kw_only=True)
class Ranking:
    """How the settings of a study are judged: by an expression, least first, by requirements, and by Pareto's order.

    front: expressions that are minimised; a setting is on the front if no other one is better in all of them.
    """

    sort: Expression | None = None
    require: tuple[Requirement, ...] = ()
    front: tuple[Expression, ...] = ()

    @staticmethod
    def parse(sort: str | None, require: Sequence[str] = (), front: Sequence[str] = ()) -> "Ranking":
        """Return the ranking of the options; raises ScenarioError for an unknown name or a wrong expression."""
        ranking = Ranking(
            sort=None if sort is None else parse_expression(sort, "--sort"),
            require=tuple(parse_requirement(text) for text in require),
            front=tuple(parse_expression(text, "--pareto") for text in front),
        )
        known = [*STATISTICS, *QUANTITIES]
        check_names(() if ranking.sort is None else ranking.sort.names, known, "--sort")
        check_names([name for part in ranking.require for name in part.names], known, "--require")
        check_consistent(ranking.require)
        check_names([name for part in ranking.front for name in part.names], known, "--pareto")
        return ranking


def ranked(sweep: Sweep, ranking: Ranking) -> list[tuple[Case, dict[str, Any]]]:
    """Return the cases in the order of a ranking, each with its judgements.

    method: of the DEM; `COLUMNS`; meets: whether the means over the trials meet all requirements; pareto: whether no
    other case that meets them is better in all expressions of the front; undecided: whether the case differs from the
    best in the expression of the order by no more than the scatter of the seeds (Welch 1947, two-sided, `UNDECIDED`).
    """
    rows: list[tuple[Case, dict[str, Any]]] = []
    judged: list[dict[str, Any]] = []
    for case in sweep.cases:
        closed = {} if case.scenario is None else quantities_of(case.scenario)
        method = "" if case.scenario is None else case.scenario.dem.map_method
        values = _values_of(case, closed, ranking)
        means = {name: np.nan if np.size(value) == 0 else np.mean(value) for name, value in values.items()}
        judged.append(values)
        shown = {name: closed.get(name, np.nan) for name in COLUMNS}
        met = {"meets": all(bool(r.margin(means) > 0) for r in ranking.require)} if ranking.require else {}
        rows.append((case, {"method": method, **shown, **met}))
    if ranking.front:
        points = [[float(np.mean(e.value(values))) for e in ranking.front] for values in judged]
        for number, (_, row) in enumerate(rows):
            rivals = [points[k] for k, (_, r) in enumerate(rows) if k != number and r.get("meets", True)]
            row["pareto"] = row.get("meets", True) and not any(_better(rival, points[number]) for rival in rivals)
    if ranking.sort is None:
        return rows
    samples = [np.atleast_1d(ranking.sort.value(values)) for values in judged]
    mean = np.array([np.mean(sample) if sample.size else np.nan for sample in samples])
    order = sorted(range(len(rows)), key=lambda k: (not rows[k][1].get("meets", True), mean[k] != mean[k], mean[k]))
    for k in order:
        rows[k][1]["undecided"] = k != order[0] and _same(samples[k], samples[order[0]])
    return [rows[k] for k in order]


def _values_of(case: Case, closed: Mapping[str, float], ranking: Ranking) -> dict[str, Any]:
    parts: list[Expression | Requirement] = [
        *([ranking.sort] if ranking.sort else []),
        *ranking.require,
        *ranking.front,
    ]
    values: dict[str, Any] = {}
    for name in dict.fromkeys(name for part in parts for name in part.names):
        if name in STATISTICS:
            values[name] = case.of_trials(name)
        elif name in QUANTITIES or case.scenario is None:
            values[name] = closed.get(name, np.nan)
        else:
            values[name] = key_value(case.scenario, name)
    return values


def _better(rival: Sequence[float], point: Sequence[float]) -> bool:
    """Return True if a rival is nowhere worse and somewhere better; any defined point is better than NaN."""
    if np.isnan(point).any():
        return True
    return bool(np.all(np.less_equal(rival, point)) and np.any(np.less(rival, point)))


def _same(sample: Float[np.ndarray, " a"], other: Float[np.ndarray, " b"]) -> bool:
    """Return True if the means of two samples differ by chance alone with a probability above `UNDECIDED`."""
    if min(sample.size, other.size) < 2 or not (np.ptp(sample) > 0 or np.ptp(other) > 0):
        return False
    return bool(ttest_ind(sample, other, equal_var=False).pvalue > UNDECIDED)
