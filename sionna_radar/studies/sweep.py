"""Studies: one scenario flown over and over, some of its values varied, with several seeds each.

Every combination of the varied values is a case, and every case is flown with the seeds s, s + 1, ... The
statistics of a case are means over its trials, and their spread is the standard deviation from trial to trial. A case
that cannot be flown, or that fails in flight, keeps its place with the reason; an interrupt keeps what is done.
"""

import logging
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from jaxtyping import Float

from sionna_radar.accuracy.compare import DemError
from sionna_radar.foundation.brief import Brief
from sionna_radar.foundation.errors import BackendError, InputFileError, Problem, RadarError, ScenarioError
from sionna_radar.foundation.interrupts import Interrupted, raise_received
from sionna_radar.foundation.progress import Progress, silent
from sionna_radar.scenario import Scenario, load_scenario
from sionna_radar.survey.chain import run
from sionna_radar.survey.preparation import prepare
from sionna_radar.survey.recording import BLOCK_SIZE

logger = logging.getLogger("sionna_radar")

MAX_RUNS = 10_000
# A table of the scenario that can be raised until the rest fits, and how often it is doubled for that.
SAMPLES = "radar.samples_per_chirp"
DOUBLINGS = 5
# Cases that `repr` names.
MAX_LINES = 8
# Statistics by their names in the results: whose cells they are of, and what of their `DemError`.
STATISTICS = {
    **{name: ("lit_error", name) for name in ("rms_m", "mean_m", "std_m", "nmad_m", "min_m", "max_m", "coverage")},
    "off_wall_rms_m": ("off_wall_error", "rms_m"),
    "all_cells_rms_m": ("dem_error", "rms_m"),
}


@dataclass(frozen=True, kw_only=True)
class Axis:
    """One varied key of the scenario and the values it takes."""

    key: str
    values: tuple[Any, ...]


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One combination of the axes' values; `scenario` is None, and `refusal` says why, where it cannot be flown."""

    setting: dict[str, Any]
    scenario: Scenario | None
    pulses: int
    refusal: str = ""


@dataclass(frozen=True, kw_only=True)
class SweepPlan:
    """What is to be flown, every combination checked, the last axis fastest."""

    source: str
    axes: tuple[Axis, ...]
    repeat: int
    cells: tuple[Cell, ...]

    @property
    def trials(self) -> int:
        """Surveys to be flown."""
        return sum(1 for _ in self.flights())

    def flights(self) -> Iterator[tuple[int, Scenario, int]]:
        """Yield the surveys in the order flown: number of the cell, its scenario, and how far its seed is raised."""
        for number, cell in enumerate(self.cells):
            if cell.scenario is not None:
                yield from ((number, cell.scenario, repeat) for repeat in range(self.repeat))


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One survey of a sweep; its errors are those of `Survey`."""

    seed: int
    echoes: int
    points_sha256: str
    dem_error: DemError
    lit_error: DemError
    off_wall_error: DemError | None
    warnings: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Case:
    """One combination of the varied values, with its trials; `reason` says why some or all are missing."""

    setting: dict[str, Any]
    scenario: Scenario | None
    trials: tuple[Trial, ...]
    reason: str = ""

    def of_trials(self, statistic: str) -> Float[np.ndarray, " trial"]:
        """Return one of STATISTICS in every trial; NaN where the run has none."""
        cells, name = STATISTICS[statistic]
        return np.array([getattr(getattr(t, cells), name, np.nan) for t in self.trials], dtype=float)

    def mean(self, statistic: str) -> float:
        """Return the mean over the trials; NaN where one has no DEM, or none is flown."""
        return float(np.mean(self.of_trials(statistic))) if self.trials else float("nan")

    def spread(self, statistic: str) -> float:
        """Return the standard deviation from trial to trial; NaN for a single trial."""
        return float(np.std(self.of_trials(statistic), ddof=1)) if len(self.trials) > 1 else float("nan")


@dataclass(frozen=True, kw_only=True)
class Sweep(Brief):
    """A finished study, or as much of it as an interrupt has left.

    source, axes, repeat: what was varied of which scenario, with how many seeds.
    cases: one for each combination of values, the last axis fastest.
    interrupted: whether an interrupt ended it.

    Examples
    --------
    >>> short = {"platform.length_m": 10.0, "terrain.spacing_m": 2.0}
    >>> plan = plan_sweep("hills", {"radar.snr_db": [20.0, 40.0]}, overrides=short)
    >>> sweep = fly_sweep(plan)
    >>> [case.setting for case in sweep.cases]
    [{'radar.snr_db': 20.0}, {'radar.snr_db': 40.0}]

    """

    source: str
    axes: tuple[Axis, ...]
    repeat: int
    cases: tuple[Case, ...]
    interrupted: bool = False

    @property
    def failed(self) -> bool:
        """Whether any case lacks a trial."""
        return any(case.reason for case in self.cases)

    def __repr__(self) -> str:
        head = f"Sweep of {self.source}: {len(self.cases)} cases x {self.repeat} seeds, RMS error of lit cells"
        results = [(c, c.reason or f"{c.mean('rms_m'):.3f} m") for c in self.cases[:MAX_LINES]]
        rows = [f"  {label(c.setting)}: {result}" for c, result in results]
        more = len(self.cases) - len(rows)
        return "\n".join([head, *rows, *([f"  and {more} more"] if more else [])])


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
    source: str | Path,
    axes: tuple[Axis, ...] | Mapping[str, Sequence[Any]],
    repeat: int = 1,
    overrides: Mapping[str, Any] | None = None,
    progress: Progress = silent,
) -> SweepPlan:
    """Load and check every combination of a study, terrain and flight included.

    A combination that cannot be flown keeps its place with the reason, and what helps where that can be found.

    Parameters
    ----------
    source:
        A scenario file, or the name of a shipped scenario.
    axes:
        What is varied: the values of each dotted key.
    repeat:
        Seeds that every combination is flown with.
    overrides:
        Dotted keys replaced in all combinations alike.
    progress:
        Called before and after each combination.

    Raises
    ------
    ScenarioError, InputFileError
        No combination can be flown; all problems of all combinations are listed.

    Examples
    --------
    >>> short = {"platform.length_m": 10.0, "terrain.spacing_m": 2.0}
    >>> plan = plan_sweep("hills", {"radar.antenna.beamwidth_deg": [2.0, 4.0]}, repeat=5, overrides=short)
    >>> len(plan.cells), plan.trials
    (2, 10)

    """
    if isinstance(axes, Mapping):
        axes = tuple(Axis(key=key, values=tuple(values)) for key, values in axes.items())
    overrides = dict(overrides or {})
    _check_request(axes, repeat, overrides)
    keys = [axis.key for axis in axes]
    settings = [dict(zip(keys, values, strict=True)) for values in product(*(axis.values for axis in axes))]
    cells, refused = [], []
    for number, setting in enumerate(settings):
        progress("checking", number, len(settings))
        try:
            scenario = load_scenario(source, overrides | setting)
            cells.append(Cell(setting=setting, scenario=scenario, pulses=len(prepare(scenario))))
        except (ScenarioError, InputFileError) as error:
            refused.append((error, setting))
            reason = _one_line(error) + _remedy(error, source, overrides | setting)
            cells.append(Cell(setting=setting, scenario=None, pulses=0, refusal=reason))
    progress("checking", len(settings), len(settings))
    if len(refused) == len(settings):
        raise _whole_refusal(refused, source)
    return SweepPlan(source=str(source), axes=axes, repeat=repeat, cells=tuple(cells))


def _one_line(error: Exception) -> str:
    problems = getattr(error, "problems", ())
    return "; ".join(map(str, problems)) or str(error)


def _remedy(error: Exception, source: str | Path, overrides: Mapping[str, Any]) -> str:
    """Return the number of samples with which a combination flies after all, where that is what it lacks."""
    problems = getattr(error, "problems", ())
    if not problems or any(problem.field != SAMPLES for problem in problems) or SAMPLES in overrides:
        return ""
    samples = load_scenario(source, {}).radar.samples_per_chirp
    for _ in range(DOUBLINGS):
        samples *= 2
        try:
            prepare(load_scenario(source, {**overrides, SAMPLES: samples}))
        except ScenarioError:
            continue
        return f" ({SAMPLES} = {samples} works)"
    return ""


def _whole_refusal(refused: Sequence[tuple[RadarError, dict[str, Any]]], source: str | Path) -> RadarError:
    """Return one error for combinations that all cannot be flown."""
    problems: dict[Problem, list[dict[str, Any]]] = {}
    for error, setting in refused:
        if not isinstance(error, ScenarioError):
            return error
        for problem in error.problems:
            problems.setdefault(problem, []).append(setting)
    return ScenarioError([_located(p, at, len(refused)) for p, at in problems.items()], f"sweep of {source}")


def _check_request(axes: tuple[Axis, ...], repeat: int, overrides: Mapping[str, Any]) -> None:
    fixed = [axis.key for axis in axes if axis.key in overrides]
    if fixed:
        _refuse(f"{fixed[0]} is both set and varied; choose one")
    if repeat < 1:
        _refuse(f"{repeat} repeats fly nothing; give at least 1", "--repeat")
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
    plan: SweepPlan,
    *,
    block_size: int = BLOCK_SIZE,
    progress: Progress = silent,
) -> Sweep:
    """Fly all trials of a study one after another.

    A trial that fails ends its case, which says why; an interrupt ends the study, which keeps the trials done.

    Parameters
    ----------
    plan:
        The study, from `plan_sweep`.
    block_size:
        Pulses simulated at once; it never changes the result.
    progress:
        Called at the start of each stage and after each of its steps: those of each survey, and the surveys.

    Raises
    ------
    BackendError
        The ray tracer cannot run here.

    Examples
    --------
    >>> short = {"platform.length_m": 10.0, "terrain.spacing_m": 2.0}
    >>> plan = plan_sweep("hills", {"radar.snr_db": [20.0, 40.0]}, overrides=short)
    >>> fly_sweep(plan).failed
    False

    """
    trials: list[list[Trial]] = [[] for _ in plan.cells]
    reasons = [cell.refusal for cell in plan.cells]
    interrupted = False
    try:
        for number, scenario, repeat in plan.flights():
            if reasons[number]:
                continue
            progress("surveys", sum(map(len, trials)), plan.trials)
            try:
                trials[number].append(_fly(scenario, repeat, block_size, progress))
            except BackendError:
                raise
            except Exception as error:
                # Hours of other trials must not be lost by one, whatever it fails of.
                raise_received()
                logger.debug("a trial failed", exc_info=True)
                reasons[number] = f"seed {scenario.seed + repeat}: {type(error).__name__}: {_one_line(error)}"
        progress("surveys", sum(map(len, trials)), plan.trials)
    except (KeyboardInterrupt, Interrupted):
        interrupted = True
    cases = [
        Case(
            setting=cell.setting,
            scenario=cell.scenario,
            trials=tuple(flown),
            reason=reason or ("" if len(flown) == plan.repeat else "interrupted"),
        )
        for cell, flown, reason in zip(plan.cells, trials, reasons, strict=True)
    ]
    return Sweep(source=plan.source, axes=plan.axes, repeat=plan.repeat, cases=tuple(cases), interrupted=interrupted)


def _fly(scenario: Scenario, repeat: int, block_size: int, progress: Progress) -> Trial:
    scenario = scenario.model_copy(update={"seed": scenario.seed + repeat})
    survey = run(scenario, block_size=block_size, progress=progress)
    return Trial(
        seed=scenario.seed,
        echoes=len(survey.points),
        points_sha256=survey.points.sha256(),
        dem_error=survey.dem_error,
        lit_error=survey.lit_error,
        off_wall_error=survey.off_wall_error,
        warnings=survey.warnings,
    )


def label(setting: Mapping[str, Any]) -> str:
    """Return a setting in short: the last part of each key, and its value."""
    return ", ".join(f"{key.split('.')[-1]} = {_text(value)}" for key, value in setting.items())


def _text(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
