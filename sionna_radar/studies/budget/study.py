"""The navigation error budget of a DEM: the largest allowed size of each GPS/IMU error on its own.

The limit of an error is the size that raises the RMS of the DEM by a tenth. Random errors are evaluated by the mean
square of several draws, constant ones by the worse of both signs.

The named grades of GPS/IMU give the sources of their numbers. Every quantity is a standard deviation and is taken as a
first-order Gauss-Markov error, since a filter's output drifts and does not jump. Basis of each number:

- First-hand, the maker's claim, untested: position, velocity and heading of the "consumer" and "rtk" grades (Blicube's
  specifications of its GRTK, RMS).
- First-hand, the maker's test, but no truth: position of the "survey" grade. It is the RMS difference between two
  post-processed solutions (PP-RTX against SmartBase, 100 data sets), the better of which is believed accurate to
  1-2 cm horizontally and 2-4 cm in height; common systematic errors do not show, and a real-time solution does not
  reach this.
- Second-hand: roll and pitch of "rtk" (the maker's claim, as listed by a user). Roll and pitch of "survey"
  are from a trade journal's report on sensors aboard a ship; an aircraft moves differently.
- From notes, the source itself not at hand when this was written: attitude of "consumer" (datasheet), and the figures
  of the trade journal.
- Our assumptions: the type of process and its correlation times, those of `NavigationTable`, which no source gives;
  that a horizontal figure combines both axes, hence each is 1 / sqrt(2) of it, and that a velocity applies to
  every axis; that the heading error of two antennas is inverse to their distance; that "survey" measures velocity no
  better than GRTK. The part of an RTK position that grows with the distance to its base, 1 mm per km, is left out.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

from pydantic import ValidationError

from sionna_radar.execution.execution import BLOCK_SIZE, Execution
from sionna_radar.execution.workers import SHARED, Task, document_bytes, document_of
from sionna_radar.foundation.bounds import check_bounds
from sionna_radar.foundation.errors import InputFileError, RadarError, ScenarioError
from sionna_radar.foundation.input_file import parse_toml, read_text
from sionna_radar.foundation.progress import stage
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.loading import identity
from sionna_radar.scenario.platform import NavigationTable
from sionna_radar.scenario.problems import translate
from sionna_radar.survey.observed_survey import ObservedSurvey, observe_survey, restored_survey

GROWTH = 0.1
# Relative tolerance of the search for the requested growth.
TOLERANCE = 0.003
MAX_STEPS = 20
MIN_RMS_M = 1e-6
# Draws of the random errors that anyone can wait for: each maps the survey once for every limit and grade.
MAX_DRAWS = 1000

Kind = Literal["constant", "white", "markov"]


@dataclass(frozen=True, kw_only=True)
class Grade:
    """A grade of GPS/IMU: its errors, and the source of the numbers."""

    errors: NavigationTable
    source: str


def load_grades(path: Path) -> dict[str, Grade]:
    """Read grades from a TOML file: tables of [platform.navigation] with a `source`; InputFileError for any other."""
    text = read_text(path, "grades", "give a TOML file of [name] tables of platform.navigation keys")
    try:
        tables = parse_toml(text)
        return {
            name: Grade(
                source=str(table.get("source", path)),
                errors=_errors(path, name, {key: v for key, v in table.items() if key != "source"}),
            )
            for name, table in tables.items()
        }
    except RadarError:
        raise
    except (ValueError, AttributeError) as error:
        message = f"{path}: not a table of navigation grades ({error}); give [name] tables of platform.navigation keys"
        raise InputFileError(message) from error


def _errors(path: Path, name: str, table: dict[str, Any]) -> NavigationTable:
    try:
        return NavigationTable.model_validate(table)
    except ValidationError as error:
        problems = [replace(p, field=f"{name}.{p.field}") for p in translate(error.errors(), NavigationTable)]
        raise InputFileError(str(ScenarioError(problems, f"{path}: not a table of navigation grades"))) from error


GRADES = load_grades(Path(__file__).with_name("grades.toml"))


@dataclass(frozen=True, kw_only=True)
class NavigationError:
    """One navigation error by its key and share on each axis; `first`, `largest`: sizes of the search for its limit."""

    name: str
    kind: Kind
    unit: str
    key: str
    axes: tuple[float, float, float] | None
    first: float
    largest: float

    def table(self, size: float) -> NavigationTable:
        """Return the navigation errors with this one only."""
        value: Any = size if self.axes is None else tuple(size * share for share in self.axes)
        return NavigationTable.model_validate({self.key: value})


@dataclass(frozen=True, kw_only=True)
class Limit:
    """Largest allowed size of an error; infinite where even `largest` stays within the growth."""

    error: NavigationError
    size: float


@dataclass(frozen=True, kw_only=True)
class GradeResult:
    """The DEM with a grade of GPS/IMU: RMS error, and coverage of the lit ground.

    refined_rms_m: with navigation that the echoes refine; None where the scenario's processing does not.
    """

    name: str
    source: str
    rms_m: float
    growth: float
    coverage: float
    refined_rms_m: float | None = None


@dataclass(frozen=True, kw_only=True)
class Budget:
    """The limits of all errors and the results of some grades, beside the RMS with the exact pose.

    growth: allowed relative growth of the RMS; repeat: draws of the random errors.
    rms_m: over lit cells, which the main beam reached.
    limits, grades: a result for each navigation error, and for each grade of GPS/IMU.

    Examples
    --------
    >>> scenario = load_scenario("hills", {"platform.length_m": 10.0})
    >>> budget = navigation_budget(scenario, errors=(), grades={})
    >>> print(repr(budget).splitlines()[0])
    Budget: Hills from 50 m: the DEM and its error (paper Fig. 12, Table 3)
    """

    scenario: Scenario
    growth: float
    repeat: int
    rms_m: float
    limits: tuple[Limit, ...]
    grades: tuple[GradeResult, ...]

    def __repr__(self) -> str:
        return (
            f"Budget: {self.scenario.description or 'no description'}\n  RMS error {self.rms_m:.3f} m with the exact "
            f"pose; {len(self.limits)} limits, {len(self.grades)} grades of GPS/IMU"
        )


def navigation_errors() -> tuple[NavigationError, ...]:
    """Return the navigation errors of a budget."""
    kinds: tuple[Kind, ...] = ("constant", "white", "markov")
    constant = kinds[:1]
    rows = [
        (kinds, "position, east and north", "m", "position_{}_m", (1.0, 1.0, 0.0), 0.05, 20.0),
        (kinds, "position, up", "m", "position_{}_m", (0.0, 0.0, 1.0), 0.05, 20.0),
        (kinds, "velocity, every axis", "m/s", "velocity_{}_mps", (1.0, 1.0, 1.0), 0.05, 20.0),
        (kinds, "roll", "deg", "attitude_{}_deg", (1.0, 0.0, 0.0), 0.1, 10.0),
        (kinds, "pitch", "deg", "attitude_{}_deg", (0.0, 1.0, 0.0), 0.1, 10.0),
        (kinds, "heading", "deg", "attitude_{}_deg", (0.0, 0.0, 1.0), 0.1, 10.0),
        (constant, "time offset", "s", "time_offset_s", None, 0.005, 2.0),
        (constant, "lever arm, every axis", "m", "lever_arm_error_m", (1.0, 1.0, 1.0), 0.05, 20.0),
        (constant, "boresight, every axis", "deg", "boresight_error_deg", (1.0, 1.0, 1.0), 0.1, 10.0),
    ]
    return tuple(
        NavigationError(name=name, kind=kind, unit=unit, key=key.format(kind), axes=axes, first=first, largest=largest)
        for own_kinds, name, unit, key, axes, first, largest in rows
        for kind in own_kinds
    )


def navigation_budget(
    scenario: Scenario,
    *,
    growth: float = GROWTH,
    limit_m: float | None = None,
    repeat: int = 5,
    errors: tuple[NavigationError, ...] | None = None,
    grades: Mapping[str, Grade] = GRADES,
    execution: Execution | None = None,
) -> Budget:
    """Fly a survey once and find the largest allowed size of each navigation error.

    Its DEM is recomputed some hundred times, by the scenario's own `dem.method`: "linear" takes a fraction of a second
    each time, "smooth" about twenty times as long, and "refined" a hundred and more.

    Parameters
    ----------
    scenario:
        The survey; its own navigation errors are ignored. With `processing.navigation = "refined"` each grade is mapped
        with the reported poses and with refined ones; limits are those of reported poses.
    growth:
        Allowed relative growth of the DEM's RMS error.
    limit_m:
        Largest RMS error allowed, in place of the growth, m.
    repeat:
        Draws of the random errors, at most 1,000.
    errors, grades:
        The errors to evaluate (all), and the grades of GPS/IMU to map with.
    execution:
        As for `sionna_radar.run`; the rows of the table are a stage after those of the survey.

    Returns
    -------
    The limit of each error in the unit of its key, the RMS of each grade, and the RMS with the exact pose, in metres.

    Raises
    ------
    ScenarioError, InputFileError
        The scenario cannot be flown, see `prepare`, its sensor returns no whole echoes for `dem.method` to model, or
        `repeat` is out of bounds.

    Examples
    --------
    >>> scenario = load_scenario("hills", {"platform.length_m": 10.0})
    >>> navigation_budget(scenario, errors=(), grades={}).rms_m < 0.2
    True
    """
    check_bounds([("--repeat", repeat, 1, MAX_DRAWS)])
    errors = navigation_errors() if errors is None else errors
    execution = execution or Execution()
    survey = observe_survey(scenario, execution=execution)
    exact = survey.lit_error(None).rms_m
    if not exact > MIN_RMS_M:
        message = (
            "no echo is detected, so that there is no DEM whose error could grow; raise it, or lower the flight"
            if math.isnan(exact)
            else f"the DEM has an error of {exact:g} m with the pose known exactly, and its growth cannot be measured"
        )
        raise ScenarioError.of("radar.snr_db" if math.isnan(exact) else "terrain", message)
    if limit_m is not None:
        growth = limit_m / exact - 1
        if not growth > 0:
            message = (
                f"rms = {limit_m:g} m is no more than the error with the pose known exactly, {exact:.3g} m; raise it"
            )
            raise ScenarioError.of_option("--limit", message)
    inputs = {"scenario": scenario.model_dump_json(), "exact": exact, "growth": growth, "repeat": repeat}
    tasks: dict[str, Task] = {f"limit {error}": {**inputs, "error": asdict(error)} for error in errors}
    tasks |= {f"grade {name} {grade}": {**inputs, "grade": [name, _document(grade)]} for name, grade in grades.items()}
    with execution.reported(), stage("mapping", len(tasks)):
        shared = survey.observed.packed() if execution.distributed else survey
        results = {key: document_of(result) for key, result in execution.done(tasks, map_task, shared=shared)}
    return Budget(
        scenario=scenario,
        growth=growth,
        repeat=repeat,
        rms_m=exact,
        limits=tuple(Limit(error=error, size=results[f"limit {error}"]) for error in errors),
        grades=tuple(GradeResult(**results[f"grade {name} {grade}"]) for name, grade in grades.items()),
    )


def map_task(task: Task) -> bytes:
    """Return the limit of a task's error, or the result of its grade, as a JSON document."""
    shared = task[SHARED]
    survey = restored_survey(task["scenario"], shared) if isinstance(shared, bytes) else shared
    if "error" in task:
        error = task["error"]
        axes = error["axes"] and tuple(error["axes"])
        limit = find_limit(
            survey, NavigationError(**{**error, "axes": axes}), task["exact"], task["growth"], task["repeat"]
        )
        return document_bytes(limit)
    name, (errors, source) = task["grade"]
    grade = Grade(errors=NavigationTable.model_validate(errors), source=source)
    rms = _mean_rms(survey, grade.errors, task["repeat"])
    coverage = survey.lit_error(survey.navigation(grade.errors)).coverage
    refined = (
        _mean_rms(survey, grade.errors, task["repeat"], refines=True) if survey.prepared.refines_navigation else None
    )
    flown = GradeResult(
        name=name,
        source=source,
        rms_m=rms,
        growth=rms / task["exact"] - 1,
        coverage=coverage,
        refined_rms_m=refined,
    )
    return document_bytes(asdict(flown))


def identity_of(scenario: Scenario, growth: float, repeat: int, grades: Mapping[str, Grade]) -> dict[str, Any]:
    """Return the inputs of a budget that determine its parts, as a JSON document."""
    named = [[name, *_document(grade)] for name, grade in grades.items()]
    return {**identity(scenario, BLOCK_SIZE), "study": [growth, repeat], "grades": named}


def _document(grade: Grade) -> list[Any]:
    return [grade.errors.model_dump(mode="json"), grade.source]


def rms_with(survey: ObservedSurvey, error: NavigationError, size: float, repeat: int) -> tuple[float, float]:
    """Return the RMS error of the DEM with one navigation error: of both signs of a constant one, larger first."""
    if error.kind == "constant":
        both = [survey.lit_error(survey.navigation(error.table(sign * size))).rms_m for sign in (1, -1)]
        return max(both), min(both)
    return (_mean_rms(survey, error.table(size), repeat),) * 2


def find_limit(survey: ObservedSurvey, error: NavigationError, exact: float, growth: float, repeat: int) -> float:
    """Return the size of an error at which the RMS exceeds the exact one by the growth; infinite if none."""
    size, low, high = error.first, (0.0, 0.0), (math.inf, math.inf)
    for _ in range(MAX_STEPS):
        worse, better = rms_with(survey, error, size, repeat)
        # Without a DEM the growth is unbounded.
        reached = math.inf if math.isnan(worse + better) else worse / exact - 1
        if abs(reached - growth) < TOLERANCE * (1 + growth):
            return size
        if reached < growth:
            if size >= error.largest:
                return math.inf
            low = (size, reached)
        else:
            high = (size, reached)
        if low[0] and math.isfinite(high[1]):
            size = _between(low, high, growth)
            continue
        ahead = _expected(size, worse / exact, better / exact, growth)
        if not low[0] < ahead < high[0]:
            ahead = 2.5 * size if math.isinf(high[0]) else _between(low, high, growth)
        size = min(ahead, error.largest)
    return size


def _mean_rms(survey: ObservedSurvey, table: NavigationTable, repeat: int, *, refines: bool = False) -> float:
    """Return the root mean square over draws of random errors; refines: see `ObservedSurvey.lit_error`."""
    seeds = [(survey.prepared.local.seed + number) % 2**63 for number in range(repeat)]
    errors = [survey.lit_error(survey.navigation(table, seed), refines=refines).rms_m for seed in seeds]
    return math.sqrt(sum(error**2 for error in errors) / repeat)


def _expected(size: float, worse: float, better: float, growth: float) -> float:
    """Return the size at which the mean square has grown, if it is a parabola of the error; NaN if it never does.

    worse, better: RMS with both signs of the error at a size, over the exact one: slope and curvature at no error.
    """
    slope = (worse**2 - better**2) / (2 * size)
    curvature = ((worse**2 + better**2) / 2 - 1) / size**2
    square = (1 + growth) ** 2 - 1
    root = slope + math.sqrt(max(slope**2 + 4 * curvature * square, 0.0))
    return 2 * square / root if root > 0 else math.nan


def _between(low: tuple[float, float], high: tuple[float, float], growth: float) -> float:
    """Return the next size to try: the mean square grows about with the square of the error."""
    square = [(1 + rise) ** 2 for rise in (low[1], high[1], growth)]
    share = (square[2] - square[0]) / (square[1] - square[0]) if square[1] > square[0] else 0.5
    # Keep off the ends, so that the bracket shrinks whatever the growth of the mean square.
    share = min(max(share, 0.1), 0.9)
    return math.sqrt(low[0] ** 2 + share * (high[0] ** 2 - low[0] ** 2))
