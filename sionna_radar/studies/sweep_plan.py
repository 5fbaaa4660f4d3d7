"""Plans of studies: every combination of the values that are varied, each checked before anything is flown.

A combination that cannot be flown keeps its place with the reason.
"""

import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from itertools import product
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from sionna_radar.foundation.errors import InputFileError, Problem, RadarError, ScenarioError, one_line
from sionna_radar.foundation.progress import Progress, silent
from sionna_radar.scenario import Scenario, load_scenario
from sionna_radar.scenario.input_files import input_files
from sionna_radar.survey.preparation import prepare

MAX_RUNS = 10_000
# A table of the scenario that can be raised until the rest fits, and how often it is doubled for that.
SAMPLES = "radar.samples_per_chirp"
DOUBLINGS = 5


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

    def identity(self) -> dict[str, Any]:
        """Return what its results depend on, as a JSON document."""
        flown = [cell.scenario for cell in self.cells if cell.scenario is not None]
        every = [scenario.model_dump_json() for scenario in flown]
        files = {name: stamp for scenario in flown for name, stamp in input_files(scenario).items()}
        return {
            "study": [self.source, [[axis.key, list(axis.values)] for axis in self.axes], self.repeat],
            "scenario": sha256("\n".join(every).encode()).hexdigest(),
            "seed": sorted({scenario.seed for scenario in flown}),
            "input file": files,
        }

    def flights(self) -> Iterator[tuple[int, Scenario, int]]:
        """Yield the surveys in the order flown: number of the cell, its scenario, and how far its seed is raised."""
        for number, cell in enumerate(self.cells):
            if cell.scenario is not None:
                yield from ((number, cell.scenario, repeat) for repeat in range(self.repeat))


@dataclass(frozen=True)
class Shard:
    """One of `count` equal parts of a study, counted from 1: every survey belongs to one."""

    number: int
    count: int

    @staticmethod
    def parse(text: str) -> "Shard":
        """Return the shard that `I/N` names; raises ScenarioError for anything else."""
        found = re.fullmatch(r"([0-9]{1,6})/([0-9]{1,6})", text.strip())
        shard = Shard(*map(int, found.groups())) if found else Shard(0, 0)
        if not 1 <= shard.number <= shard.count:
            message = f"{text!r} is no shard; give I/N with I from 1 to N, such as 2/8"
            _refuse(message, "--shard")
        return shard

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"

    def holds(self, survey: int) -> bool:
        """Return whether a survey belongs to it, by its running number in the study."""
        return survey % self.count == self.number - 1


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
            reason = one_line(error) + _remedy(error, source, overrides | setting)
            cells.append(Cell(setting=setting, scenario=None, pulses=0, refusal=reason))
    progress("checking", len(settings), len(settings))
    if len(refused) == len(settings):
        raise _whole_refusal(refused, source)
    return SweepPlan(source=str(source), axes=axes, repeat=repeat, cells=tuple(cells))


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


def label(setting: Mapping[str, Any]) -> str:
    """Return a setting in short: the last part of each key, and its value."""
    return ", ".join(f"{key.split('.')[-1]} = {_text(value)}" for key, value in setting.items())


def _text(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
