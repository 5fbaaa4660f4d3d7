"""Studies: one scenario flown over and over, some of its values varied, with several seeds each.

Every combination of the varied values is a case, and every case is flown with the seeds s, s + 1, ... The
statistics of a case are means over its runs, and their spread is the standard deviation from run to run.
"""

import csv
import io
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from jaxtyping import Float

from sionna_radar.errors import Problem, ScenarioError
from sionna_radar.mapping.compare import DemError
from sionna_radar.preparation import prepare
from sionna_radar.report.folder import write_study
from sionna_radar.report.summary import versions
from sionna_radar.scenario import Scenario, load_scenario
from sionna_radar.survey import BLOCK_SIZE, run

MARKER = "sweep.json"
STATISTICS = ("min_m", "max_m", "std_m", "mean_m", "rms_m", "nmad_m", "coverage")
MAX_RUNS = 10_000


@dataclass(frozen=True, kw_only=True)
class Axis:
    """One varied key of the scenario and the values it takes."""

    key: str
    values: tuple[Any, ...]


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What is to be flown, every combination checked.

    scenarios: one for each combination of the axes' values, the last axis fastest.
    settings: the values of the axes in each.
    pulses: pulses of one run of each.
    """

    source: str
    axes: tuple[Axis, ...]
    repeat: int
    settings: tuple[dict[str, Any], ...]
    scenarios: tuple[Scenario, ...]
    pulses: tuple[int, ...]

    @property
    def total_pulses(self) -> int:
        """Pulses of all runs."""
        return self.repeat * sum(self.pulses)


@dataclass(frozen=True, kw_only=True)
class Run:
    """One survey of a sweep."""

    seed: int
    echoes: int
    points_sha256: str
    dem_error: DemError


@dataclass(frozen=True, kw_only=True)
class Case:
    """One combination of the varied values, with its runs."""

    setting: dict[str, Any]
    scenario: Scenario
    runs: tuple[Run, ...]

    def of_runs(self, statistic: str) -> Float[np.ndarray, " run"]:
        """Return a statistic of `DemError` in every run."""
        return np.array([getattr(r.dem_error, statistic) for r in self.runs], dtype=float)

    def mean(self, statistic: str) -> float:
        """Return the mean over the runs; NaN where a run has no DEM."""
        return float(np.mean(self.of_runs(statistic)))

    def spread(self, statistic: str) -> float:
        """Return the standard deviation from run to run; NaN for a single run."""
        return float(np.std(self.of_runs(statistic), ddof=1)) if len(self.runs) > 1 else float("nan")


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """A finished study."""

    source: str
    axes: tuple[Axis, ...]
    repeat: int
    cases: tuple[Case, ...]


# ------------------------------------------------------------------------------------------- planning


def parse_axes(assignments: Iterable[str]) -> tuple[Axis, ...]:
    """Read `KEY=V1,V2,...` assignments; values are TOML, and bare words are strings.

    Raises
    ------
    ScenarioError
        No key, no value, or a key or value given twice.

    """
    axes: dict[str, Axis] = {}
    for assignment in assignments:
        key, separator, text = (part.strip() for part in assignment.partition("="))
        if not separator or not key or not text:
            _refuse(f"{assignment!r} is not KEY=V1,V2,...")
        if key in axes:
            _refuse(f"{key} is varied twice; list all its values once")
        axes[key] = Axis(key=key, values=_values(key, text))
    if not axes:
        _refuse("nothing is varied; give at least one KEY=V1,V2,...")
    return tuple(axes.values())


def _values(key: str, text: str) -> tuple[Any, ...]:
    try:
        values = tuple(tomllib.loads(f"values = [{text}]")["values"])
    except tomllib.TOMLDecodeError:
        # Some are bare words: split at the commas outside brackets.
        values = tuple(_value(part.strip()) for part in re.split(r",(?![^\[]*\])", text))
    if "" in values:
        _refuse(f"{key} has an empty value in {text!r}; take out the extra comma")
    repeated = [value for index, value in enumerate(values) if value in values[:index]]
    if repeated:
        _refuse(f"{key} takes the value {repeated[0]!r} twice; name it once")
    return values


def _value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def plan_sweep(
    source: str | Path, axes: tuple[Axis, ...], repeat: int = 1, overrides: Mapping[str, Any] | None = None
) -> Plan:
    """Load and check every combination of a study, terrain and flight included.

    Parameters
    ----------
    source:
        A scenario file, or the name of a shipped scenario.
    axes:
        What is varied.
    repeat:
        Seeds that every combination is flown with.
    overrides:
        Dotted keys replaced in all combinations alike.

    Raises
    ------
    ScenarioError, InputFileError
        A combination cannot be flown; all problems of all combinations are listed.

    """
    overrides = dict(overrides or {})
    _check_request(axes, repeat, overrides)
    keys = [axis.key for axis in axes]
    settings = tuple(dict(zip(keys, values, strict=True)) for values in product(*(axis.values for axis in axes)))
    scenarios, pulses = [], []
    problems: dict[Problem, list[dict[str, Any]]] = {}
    for setting in settings:
        try:
            scenario = load_scenario(source, overrides | setting)
            pulses.append(len(prepare(scenario).schedule))
            scenarios.append(scenario)
        except ScenarioError as error:
            for problem in error.problems:
                problems.setdefault(problem, []).append(setting)
    if problems:
        raise ScenarioError([_located(p, at, len(settings)) for p, at in problems.items()], f"sweep of {source}")
    return Plan(
        source=str(source),
        axes=axes,
        repeat=repeat,
        settings=settings,
        scenarios=tuple(scenarios),
        pulses=tuple(pulses),
    )


def _check_request(axes: tuple[Axis, ...], repeat: int, overrides: Mapping[str, Any]) -> None:
    fixed = [axis.key for axis in axes if axis.key in overrides]
    if fixed:
        _refuse(f"{fixed[0]} is both set and varied; choose one")
    if repeat < 1:
        _refuse(f"{repeat} repeats are no study; give at least 1", "--repeat")
    if repeat > 1 and any(axis.key == "seed" for axis in axes):
        _refuse("seed is varied, and repeats take seeds of their own; choose one", "--repeat")
    runs = repeat * int(np.prod([len(axis.values) for axis in axes]))
    if runs > MAX_RUNS:
        _refuse(f"{runs:,} surveys are more than {MAX_RUNS:,}; name fewer values or repeats")


def _located(problem: Problem, settings: list[dict[str, Any]], combinations: int) -> Problem:
    """Return a problem that says which combination has it, unless all have."""
    if len(settings) == combinations:
        return problem
    return Problem(problem.field, f"{problem.message} (at {label(settings[0])})")


def _refuse(message: str, field: str = "--vary") -> NoReturn:
    raise ScenarioError([Problem(field, message)], "command line")


# --------------------------------------------------------------------------------------------- flying


def fly_sweep(
    plan: Plan,
    *,
    block_size: int = BLOCK_SIZE,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Sweep:
    """Fly all runs of a study one after another.

    Parameters
    ----------
    plan:
        The study, from `plan_sweep`.
    block_size:
        Pulses simulated at once; it never changes the result.
    progress:
        Called after each block with the pulses done and the pulses in all.

    """
    done, cases = 0, []
    for setting, scenario, pulses in zip(plan.settings, plan.scenarios, plan.pulses, strict=True):
        runs = []
        for number in range(plan.repeat):
            repeated = scenario.model_copy(update={"seed": scenario.seed + number})
            before = done

            def report(here: int, _: int, before: int = before) -> None:
                progress(before + here, plan.total_pulses)

            runs.append(_fly(repeated, block_size, report))
            done += pulses
        cases.append(Case(setting=setting, scenario=scenario, runs=tuple(runs)))
    return Sweep(source=plan.source, axes=plan.axes, repeat=plan.repeat, cases=tuple(cases))


def _fly(scenario: Scenario, block_size: int, progress: Callable[[int, int], None]) -> Run:
    survey = run(scenario, block_size=block_size, progress=progress)
    return Run(
        seed=scenario.seed,
        echoes=len(survey.points),
        points_sha256=survey.points.sha256(),
        dem_error=survey.dem_error,
    )


# -------------------------------------------------------------------------------------------- results


def label(setting: Mapping[str, Any]) -> str:
    """Return a setting in short: the last part of each key, and its value."""
    return ", ".join(f"{key.split('.')[-1]} = {_text(value)}" for key, value in setting.items())


def _text(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def summary(sweep: Sweep) -> dict[str, Any]:
    """Return the study as one document of strict JSON values, but for NaN."""
    return {
        "source": sweep.source,
        "axes": [asdict(axis) for axis in sweep.axes],
        "repeat": sweep.repeat,
        "spread": "standard deviation from run to run (n - 1)",
        "cases": [
            {
                "setting": case.setting,
                "statistics": {s: {"mean": case.mean(s), "spread": case.spread(s)} for s in STATISTICS},
                "runs": [asdict(r) for r in case.runs],
                "scenario": case.scenario.model_dump(mode="json"),
            }
            for case in sweep.cases
        ],
        "versions": versions(),
    }


def table_csv(sweep: Sweep) -> str:
    """Return one row a case: the setting, the mean of each statistic and its spread; nothing for NaN."""
    keys = [axis.key for axis in sweep.axes]
    header = [*keys, "runs", *(column for s in STATISTICS for column in (s, f"{s}_spread"))]
    rows = [
        [*case.setting.values(), len(case.runs), *(v for s in STATISTICS for v in (case.mean(s), case.spread(s)))]
        for case in sweep.cases
    ]
    return _csv(header, rows)


def runs_csv(sweep: Sweep) -> str:
    """Return one row a run: the setting, the seed and every statistic of the DEM's error."""
    names = [f.name for f in fields(DemError)]
    header = [*(axis.key for axis in sweep.axes), "run_seed", "echoes", *names]
    rows = [
        [*case.setting.values(), r.seed, r.echoes, *(getattr(r.dem_error, name) for name in names)]
        for case in sweep.cases
        for r in case.runs
    ]
    return _csv(header, rows)


def _csv(header: list[str], rows: list[list[Any]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows([["" if value != value else value for value in row] for row in rows])
    return text.getvalue()


def write(sweep: Sweep, directory: Path) -> list[Path]:
    """Write `sweep.json`, `table.csv`, `runs.csv` and the figure, all or nothing, and return the files.

    An earlier sweep in the directory is replaced as a whole.

    Raises
    ------
    OutputError
        The directory holds something else, or cannot be written.

    """
    from sionna_radar.report.sweep_figures import draw_all

    tables = {"table.csv": table_csv(sweep), "runs.csv": runs_csv(sweep)}
    return write_study(directory, MARKER, summary(sweep), partial(draw_all, sweep), tables)
