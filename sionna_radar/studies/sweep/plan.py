"""Plans of a study: every setting of the varied keys, its scenario checked before the first flight.

Scenes are built by the process that flies over them. Shards share the flights of a plan among the jobs of an array.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

from sionna_radar.execution.workers import Failure
from sionna_radar.foundation.errors import InputFileError, Problem, RadarError, ScenarioError, one_line
from sionna_radar.foundation.progress import advance, stage
from sionna_radar.scenario import Scenario, load_scenario
from sionna_radar.scenario.loading import input_files
from sionna_radar.studies.sweep.settings import Axis, Design, Setting, label, one_setting, refuse
from sionna_radar.survey.preparation import prepare

MAX_RUNS = 100_000
# A key that is raised until the rest of the scenario fits, and the largest number of doublings.
SAMPLES = "radar.samples_per_chirp"
DOUBLINGS = 5


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One setting of the varied keys; if refused, `scenario` is None and `refusal` the reason."""

    setting: Setting
    scenario: Scenario | None
    refusal: str = ""


@dataclass(frozen=True, kw_only=True)
class SweepPlan:
    """Planned flights of a study: the varied keys with all their values, and the settings in the order of `Design`."""

    source: str
    axes: tuple[Axis, ...]
    repeat: int
    cells: tuple[Cell, ...]

    @property
    def trials(self) -> int:
        """Number of surveys to be flown."""
        return sum(1 for _ in self.flights())

    def identity(self) -> dict[str, Any]:
        """Return the inputs that determine the results, as a JSON document."""
        flown = [cell.scenario for cell in self.cells if cell.scenario is not None]
        documents = [scenario.model_dump_json() for scenario in flown]
        files = {name: stamp for scenario in flown for name, stamp in input_files(scenario).items()}
        return {
            "study": [self.source, [cell.setting for cell in self.cells], self.repeat],
            "scenario": sha256("\n".join(documents).encode()).hexdigest(),
            "seed": sorted({scenario.seed for scenario in flown}),
            "input file": files,
        }

    def flights(self) -> Iterator[tuple[int, Scenario, int]]:
        """Yield the surveys in the order flown: number of the cell, its scenario, and offset of its seed."""
        for number, cell in enumerate(self.cells):
            if cell.scenario is not None:
                yield from ((number, cell.scenario, repeat) for repeat in range(self.repeat))


@dataclass(frozen=True)
class Shard:
    """Shard `number` of `count`, from 1: every survey is in exactly one of them."""

    number: int
    count: int

    @staticmethod
    def parse(text: str) -> "Shard":
        """Return the shard for `I/N`; raises ScenarioError for anything else."""
        match = re.fullmatch(r"([0-9]{1,6})/([0-9]{1,6})", text.strip())
        shard = Shard(*map(int, match.groups())) if match else Shard(0, 0)
        if not 1 <= shard.number <= shard.count:
            refuse(f"{text!r} is no shard; give I/N with I from 1 to N, such as 2/8", "--shard")
        return shard

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"

    def holds(self, survey: int) -> bool:
        """Return True if a survey is in the shard, by index in the study from 0."""
        return survey % self.count == self.number - 1


def plan_sweep(
    source: str | Path,
    varied: Design | Sequence[Axis] | Mapping[str, Sequence[Any]],
    repeat: int = 1,
    overrides: Mapping[str, Any] | None = None,
) -> SweepPlan:
    """Load the scenario of every setting; prepare in turn until one is flyable.

    A setting that cannot be flown keeps its place with the reason, and the remedy where one is found.

    Parameters
    ----------
    source:
        A scenario file, or the name of a shipped scenario.
    varied:
        The values of each varied dotted key, or a `Design` with sampled ranges or rows of a table. Empty: only the
        seeds of several repeats.
    repeat:
        Number of seeds per setting.
    overrides:
        Dotted keys replaced in all settings.

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
    alone = repeat > 1 and not isinstance(varied, Design) and not varied
    design, overrides = Design(seeds_alone=True) if alone else Design.of(varied), dict(overrides or {})
    _check_request(design, repeat, overrides)
    given = overrides | next(iter(design.rows), {}) | one_setting(design.listed, design.spans)
    base = load_scenario(source, given) if design.spans else None
    settings = design.settings(base)
    cells, refused, flyable = [], [], False
    with stage("checking", len(settings)):
        for setting in settings:
            scenario = None
            try:
                scenario = load_scenario(source, overrides | setting)
                # One flyable setting shows that the study is not wrong as a whole; the others are built in flight.
                if not flyable:
                    prepare(scenario)
                    flyable = True
                cells.append(Cell(setting=setting, scenario=scenario))
            except (ScenarioError, InputFileError) as error:
                refused.append((error, setting))
                cells.append(Cell(setting=setting, scenario=None, refusal=refusal(error, scenario)))
            advance()
    if len(refused) == len(settings):
        raise _whole_refusal(refused, source)
    return SweepPlan(source=str(source), axes=design.axes(settings), repeat=repeat, cells=tuple(cells))


def refusal(error: Exception, scenario: Scenario | None) -> str:
    """Return the reason why a scenario cannot be flown, with a sample count that works, if found."""
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


def failure(outcome: Failure, scenario: Scenario, repeat: int) -> str:
    """Return the message of a failed survey, with its seed unless the scenario itself is refused."""
    if outcome.kind in (ScenarioError.__name__, InputFileError.__name__):
        return refusal(outcome.error(), scenario)
    return f"seed {scenario.seed + repeat}: {outcome.kind}: {outcome.text}"


def _whole_refusal(refused: Sequence[tuple[RadarError, dict[str, Any]]], source: str | Path) -> RadarError:
    problems: dict[Problem, list[dict[str, Any]]] = {}
    for error, setting in refused:
        if not isinstance(error, ScenarioError):
            return error
        for problem in error.problems:
            problems.setdefault(problem, []).append(setting)
    located = [
        p if len(at) == len(refused) else Problem(p.field, f"{p.message} (at {label(at[0])})")
        for p, at in problems.items()
    ]
    return ScenarioError(located, f"sweep of {source}")


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
