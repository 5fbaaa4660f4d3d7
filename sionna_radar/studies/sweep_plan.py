"""Plans of studies: every setting of what is varied, its scenario checked before anything is flown.

Scenes are built where they are flown over. A setting that cannot be flown keeps its place with the reason.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

from sionna_radar.foundation.errors import InputFileError, Problem, RadarError, ScenarioError, one_line
from sionna_radar.foundation.progress import Progress, silent
from sionna_radar.foundation.workers import Failure
from sionna_radar.scenario import Scenario, load_scenario
from sionna_radar.scenario.input_files import input_files
from sionna_radar.studies.design import Axis, Design, Setting, refuse
from sionna_radar.survey.preparation import prepare

MAX_RUNS = 100_000
# Letters of a value that is told people.
LONGEST_SHOWN = 48
# A table of the scenario that can be raised until the rest fits, and how often it is doubled for that.
SAMPLES = "radar.samples_per_chirp"
DOUBLINGS = 5


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One setting of the varied keys; `scenario` is None, and `refusal` says why, where it cannot be flown."""

    setting: Setting
    scenario: Scenario | None
    refusal: str = ""


@dataclass(frozen=True, kw_only=True)
class SweepPlan:
    """What is to be flown.

    axes: the varied keys, with all values that they take.
    cells: the settings, in the order of `Design`.
    """

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
            "study": [self.source, [cell.setting for cell in self.cells], self.repeat],
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
            refuse(message, "--shard")
        return shard

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"

    def holds(self, survey: int) -> bool:
        """Return whether a survey belongs to it, by its running number in the study."""
        return survey % self.count == self.number - 1


def plan_sweep(
    source: str | Path,
    varied: Design | Sequence[Axis] | Mapping[str, Sequence[Any]],
    repeat: int = 1,
    overrides: Mapping[str, Any] | None = None,
    progress: Progress = silent,
) -> SweepPlan:
    """Load the scenario of every setting of a study, and prepare one that can be flown.

    A setting that cannot be flown keeps its place with the reason, and what helps where that can be found.

    Parameters
    ----------
    source:
        A scenario file, or the name of a shipped scenario.
    varied:
        What is varied: the values of each dotted key, or a `Design` with ranges that are sampled or rows of a table.
    repeat:
        Seeds that every setting is flown with.
    overrides:
        Dotted keys replaced in all settings alike.
    progress:
        Called before and after each setting.

    Raises
    ------
    ScenarioError, InputFileError
        No setting can be flown; all problems of all settings are listed.

    Examples
    --------
    >>> short = {"platform.length_m": 10.0, "terrain.spacing_m": 2.0}
    >>> plan = plan_sweep("hills", {"radar.antenna.beamwidth_deg": [2.0, 4.0]}, repeat=5, overrides=short)
    >>> len(plan.cells), plan.trials
    (2, 10)

    """
    design, overrides = Design.of(varied), dict(overrides or {})
    _check_request(design, repeat, overrides)
    base = load_scenario(source, overrides) if design.spans else None
    settings = design.settings(base)
    cells, refused, flyable = [], [], False
    for number, setting in enumerate(settings):
        progress("checking", number, len(settings))
        scenario = None
        try:
            scenario = load_scenario(source, overrides | setting)
            # One that is ready to fly shows that the study is no mistake as a whole; the others are built in flight.
            if not flyable:
                prepare(scenario)
                flyable = True
            cells.append(Cell(setting=setting, scenario=scenario))
        except (ScenarioError, InputFileError) as error:
            refused.append((error, setting))
            cells.append(Cell(setting=setting, scenario=None, refusal=refusal(error, scenario)))
    progress("checking", len(settings), len(settings))
    if len(refused) == len(settings):
        raise _whole_refusal(refused, source)
    return SweepPlan(source=str(source), axes=design.axes(settings), repeat=repeat, cells=tuple(cells))


def refusal(error: Exception, scenario: Scenario | None) -> str:
    """Return why a scenario cannot be flown, and the number of samples with which it can, if that is all it lacks."""
    reason, problems = one_line(error), getattr(error, "problems", ())
    if scenario is None or not problems or any(p.field != SAMPLES for p in problems):
        return reason
    samples = scenario.radar.samples_per_chirp
    for _ in range(DOUBLINGS):
        samples *= 2
        radar = scenario.radar.model_copy(update={"samples_per_chirp": samples})
        try:
            prepare(scenario.model_copy(update={"radar": radar}))
        except ScenarioError:
            continue
        return f"{reason} ({SAMPLES} = {samples} works)"
    return reason


def failure(found: Failure, scenario: Scenario, repeat: int) -> str:
    """Return why a survey of a study has failed: what cannot be flown with any seed, or else the seed and the error."""
    if found.kind in (ScenarioError.__name__, InputFileError.__name__):
        return refusal(found.error(), scenario)
    return f"seed {scenario.seed + repeat}: {found.kind}: {found.text}"


def _whole_refusal(refused: Sequence[tuple[RadarError, dict[str, Any]]], source: str | Path) -> RadarError:
    """Return one error for settings that all cannot be flown."""
    problems: dict[Problem, list[dict[str, Any]]] = {}
    for error, setting in refused:
        if not isinstance(error, ScenarioError):
            return error
        for problem in error.problems:
            problems.setdefault(problem, []).append(setting)
    return ScenarioError([_located(p, at, len(refused)) for p, at in problems.items()], f"sweep of {source}")


def _check_request(design: Design, repeat: int, overrides: Mapping[str, Any]) -> None:
    fixed = [key for key in design.keys if key in overrides]
    if fixed:
        refuse(f"{fixed[0]} is both set and varied; choose one")
    if repeat < 1:
        refuse(f"{repeat} repeats fly nothing; give at least 1", "--repeat")
    if repeat > 1 and "seed" in design.keys:
        refuse("seed is varied, and repeats take seeds of their own; choose one", "--repeat")
    runs = repeat * len(design)
    if runs > MAX_RUNS:
        refuse(f"{runs:,} surveys are more than {MAX_RUNS:,}; name fewer values, samples or repeats")


def _located(problem: Problem, settings: list[dict[str, Any]], count: int) -> Problem:
    """Return a problem that says which setting has it, unless all have."""
    if len(settings) == count:
        return problem
    return Problem(problem.field, f"{problem.message} (at {label(settings[0])})")


def label(setting: Mapping[str, Any]) -> str:
    """Return a setting in short: the last part of each key, and its value."""
    if not setting:
        return "nothing changed"
    return ", ".join(f"{key.split('.')[-1]} = {short(value)}" for key, value in setting.items())


def short(value: Any) -> str:
    """Return a value of a setting for people: of a long one, such as a list of tables, the beginning and the end."""
    text = f"{value:g}" if isinstance(value, float) else str(value)
    return text if len(text) <= LONGEST_SHOWN else f"{text[: LONGEST_SHOWN - 16]} ... {text[-11:]}"
