"""Studies of one scenario, with varied values and several seeds each: plans, flights, statistics and shards.

Every setting of the varied keys is a case, and every case is flown with the seeds s, s + 1, ... The
statistics of a case are means over its trials, and their spread is the standard deviation from trial to trial. A case
that cannot be flown, or that fails in flight, keeps its place with the reason; an interrupt keeps finished trials.

A plan holds every setting of the varied keys, with its scenario checked before the first flight; scenes are built by
the process that flies over them. The result holds cases with their trials and statistics. Shards of a study, flown by
the jobs of an array, are merged.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2, norm

from sionna_radar.accuracy.compare import DemError
from sionna_radar.execution.execution import Execution
from sionna_radar.execution.workers import Failure, Task, document_bytes, document_of
from sionna_radar.foundation.columns import columns_of, packed, table_of
from sionna_radar.foundation.errors import BackendError, InputFileError, Problem, RadarError, ScenarioError, one_line
from sionna_radar.foundation.interrupts import Interrupted
from sionna_radar.foundation.progress import advance, stage
from sionna_radar.foundation.raster import Raster
from sionna_radar.scenario import Scenario, load_scenario
from sionna_radar.scenario.loading import input_files
from sionna_radar.studies.sweep.settings import Axis, Design, Setting, one_setting, refuse
from sionna_radar.survey.chain import run
from sionna_radar.survey.preparation import prepare
from sionna_radar.survey.result import Survey

MAX_RUNS = 100_000
# Longest shown value, in characters.
LONGEST_SHOWN = 48
# A key that is raised until the rest of the scenario fits, and the largest number of doublings.
SAMPLES = "radar.samples_per_chirp"
DOUBLINGS = 5
# Maps of a trial, by the names of their files.
MAPS = ("dem", "dem_sigma", "error")
# Largest distance between corners of cells that coincide, in cells: map coordinates are rounded to a micrometre.
ALIGNED = 1e-3


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


def label(setting: Mapping[str, Any]) -> str:
    """Return a setting in short: the last part of each key, and its value."""
    if not setting:
        return "nothing changed"
    return ", ".join(f"{key.split('.')[-1]} = {short(value)}" for key, value in setting.items())


def short(value: Any) -> str:
    """Return a readable value of a setting; long ones, such as lists of tables, are abbreviated."""
    text = f"{value:g}" if isinstance(value, float) else str(value)
    return text if len(text) <= LONGEST_SHOWN else f"{text[: LONGEST_SHOWN - 16]} ... {text[-11:]}"


# Largest number of cases in `repr`.
MAX_LINES = 8
# Statistics of a trial itself, and all by their names in the results: its error, and the field of this `DemError`.
PROBABILITIES = ("pd_wire", "pd_obstacle")
OBSTACLE_STATISTICS = (*PROBABILITIES, "warning_s", "false_alarms_per_km2", "false_alarms_per_minute")
# Over what false alarms are counted: a statistic, and how much of it is one unit.
EXPOSURES = {"false_alarms_per_km2": ("mapped_m2", 1e6), "false_alarms_per_minute": ("flown_s", 60.0)}
OWN_STATISTICS = (
    *("mapped_m2", "mapped_swath_m", "coverage_of_swath", "stated_sigma_m", "common_rms_m"),
    *OBSTACLE_STATISTICS,
)
STATISTICS = {
    **{
        name: ("lit_error", name)
        for name in ("rms_m", "mean_m", "std_m", "nmad_m", "le90_m", "min_m", "max_m", "coverage")
    },
    "off_wall_rms_m": ("off_wall_error", "rms_m"),
    "all_cells_rms_m": ("dem_error", "rms_m"),
    **{name: ("", name) for name in OWN_STATISTICS},
}


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One survey of a sweep; its errors are those of `Survey`.

    mapped_m2, mapped_swath_m, coverage_of_swath: see `MappedGround`; None where undefined.
    pd_wire, pd_obstacle, warning_s, false_alarms_per_km2, false_alarms_per_minute: see `ObstacleReport.rates`; None
        where undefined.
    stated_sigma_m: root mean square of the DEM's stated standard deviation over lit cells; None if none is stated.
    flown_s: time in which pulses are transmitted.
    common_rms_m: RMS error of the cells that every survey of the study lit and filled; None in a shard, and where the
        cells of the maps do not coincide.
    maps: by name, if kept: `dem`, `dem_sigma` where stated, and `error`, DEM minus truth over lit cells.
    wall_s, peak_memory_mb: cost of the flight, which varies from run to run and is ignored in comparisons.
    """

    seed: int
    echoes: int
    points_sha256: str
    dem_error: DemError
    lit_error: DemError
    off_wall_error: DemError | None
    warnings: tuple[str, ...]
    mapped_m2: float | None = None
    mapped_swath_m: float | None = None
    coverage_of_swath: float | None = None
    stated_sigma_m: float | None = None
    common_rms_m: float | None = None
    pd_wire: float | None = None
    pd_obstacle: float | None = None
    warning_s: float | None = None
    false_alarms_per_km2: float | None = None
    false_alarms_per_minute: float | None = None
    flown_s: float | None = None
    maps: Mapping[str, Raster] = field(default_factory=dict, compare=False, repr=False)
    wall_s: float = field(compare=False)
    peak_memory_mb: float = field(compare=False)

    def statistic(self, name: str) -> float:
        """Return one of STATISTICS; NaN where undefined."""
        cells, key = STATISTICS[name]
        value = getattr(getattr(self, cells) if cells else self, key, None)
        return float("nan") if value is None else float(value)

    @staticmethod
    def of_document(document: Mapping[str, Any]) -> "Trial":
        """Return the trial of a document made by `asdict`; None in an error is NaN, as JSON files hold it."""
        errors = {kind: _error_of(document[kind]) for kind in ("dem_error", "lit_error", "off_wall_error")}
        return Trial(**{**document, **errors, "warnings": tuple(document["warnings"])})


def _error_of(document: Mapping[str, Any] | None) -> DemError | None:
    values: dict[str, Any] = {name: np.nan if value is None else value for name, value in (document or {}).items()}
    return DemError(**values) if values else None


def wilson_interval(share: float, count: int) -> tuple[float, float]:
    """Return the interval of 95 % of a probability from the share of a number of draws."""
    z = float(norm.ppf(0.975))
    middle, scale = share + z**2 / (2 * count), 1 + z**2 / count
    half = z * np.sqrt(share * (1 - share) / count + z**2 / (4 * count**2))
    return float((middle - half) / scale), float((middle + half) / scale)


@dataclass(frozen=True, kw_only=True)
class Case:
    """One setting of the varied keys, with its trials; `reason` explains missing ones."""

    setting: dict[str, Any]
    scenario: Scenario | None
    trials: tuple[Trial, ...]
    reason: str = ""

    def of_trials(self, statistic: str) -> Float[np.ndarray, " trial"]:
        """Return one of STATISTICS in every trial; NaN where undefined."""
        return np.array([t.statistic(statistic) for t in self.trials], dtype=float)

    def mean(self, statistic: str) -> float:
        """Return the mean over the trials; NaN if undefined in one, or no trials."""
        return float(np.mean(self.of_trials(statistic))) if self.trials else float("nan")

    def interval(self, statistic: str) -> tuple[float, float]:
        """Return the interval of 95 % of a rate of reported obstacles; NaN for others, and where undefined.

        Of a probability by Wilson, with the trials as draws; of false alarms over all area or time by the Poisson
        distribution.
        """
        values = self.of_trials(statistic)
        if len(values) == 0 or not np.isfinite(values).all():
            return float("nan"), float("nan")
        if statistic in PROBABILITIES:
            return wilson_interval(float(values.mean()), len(values))
        if statistic not in EXPOSURES:
            return float("nan"), float("nan")
        name, unit = EXPOSURES[statistic]
        exposure = np.array([getattr(trial, name) or 0.0 for trial in self.trials]) / unit
        if not exposure.sum() > 0:
            return float("nan"), float("nan")
        alarms = round(float(values @ exposure))
        low = chi2.ppf(0.025, 2 * alarms) / 2 if alarms else 0.0
        return float(low / exposure.sum()), float(chi2.ppf(0.975, 2 * alarms + 2) / 2 / exposure.sum())

    def spread(self, statistic: str) -> float:
        """Return the standard deviation from trial to trial; NaN for a single trial."""
        return float(np.std(self.of_trials(statistic), ddof=1)) if len(self.trials) > 1 else float("nan")


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """Results of a study or shard, whole or up to an interrupt.

    source, axes, repeat: the scenario, its varied keys, and number of seeds.
    cases: one for each setting.
    interrupted: True if an interrupt ended it.
    shard: part of the study, as I/N; "" for the whole.

    Examples
    --------
    >>> short = {"platform.length_m": 10.0, "terrain.spacing_m": 2.0}
    >>> plan = plan_sweep("hills", {"radar.snr_db": [20.0, 40.0]}, overrides=short)
    >>> sweep = run_sweep(plan)
    >>> [case.setting for case in sweep.cases]
    [{'radar.snr_db': 20.0}, {'radar.snr_db': 40.0}]
    """

    source: str
    axes: tuple[Axis, ...]
    repeat: int
    cases: tuple[Case, ...]
    interrupted: bool = False
    shard: str = ""

    @property
    def failed(self) -> bool:
        """True if any case lacks a trial."""
        return any(case.reason for case in self.cases)

    def __repr__(self) -> str:
        head = f"Sweep of {self.source}: {len(self.cases)} cases x {self.repeat} seeds, RMS error of lit cells"
        results = [(c, c.reason or f"{c.mean('rms_m'):.3f} m") for c in self.cases[:MAX_LINES]]
        rows = [f"  {label(c.setting)}: {result}" for c, result in results]
        hidden = len(self.cases) - len(rows)
        return "\n".join([head, *rows, *([f"  and {hidden} more"] if hidden else [])])


# A cell of the plan, and the offset of the seed.
Place = tuple[int, int]


def sweep(
    scenario: str | Path,
    varied: Design | Sequence[Axis] | Mapping[str, Sequence[Any]],
    repeat: int = 1,
    overrides: Mapping[str, Any] | None = None,
    *,
    execution: Execution | None = None,
) -> Sweep:
    """Fly a scenario with varied values; `plan_sweep` and `run_sweep` in one call.

    Parameters
    ----------
    scenario, varied, repeat, overrides:
        As for `plan_sweep`, whose `source` is the scenario.
    execution:
        As for `sionna_radar.run`; the surveys are a stage, beside those of each.

    Returns
    -------
    The results of each setting with each seed; errors in metres.

    Raises
    ------
    ScenarioError, InputFileError
        No setting can be flown; all problems of all settings are listed.

    Examples
    --------
    >>> short = {"platform.length_m": 10.0, "terrain.spacing_m": 2.0}
    >>> [len(case.trials) for case in sweep("hills", {"radar.snr_db": [20.0, 40.0]}, overrides=short).cases]
    [1, 1]
    """
    return run_sweep(plan_sweep(scenario, varied, repeat, overrides), execution=execution)


def run_sweep(
    plan: SweepPlan, *, shard: Shard | None = None, keep_maps: bool = False, execution: Execution | None = None
) -> Sweep:
    """Fly all trials of a study, or of one shard: sequentially, or on workers.

    A case with a failed trial holds the reason. An interrupt ends the study, which keeps finished trials; with
    checkpoints it resumes from them.

    Parameters
    ----------
    plan:
        The study, from `plan_sweep`.
    shard:
        Subset of the trials to fly; see `Shard`. None for all.
    keep_maps:
        Hold the maps of all trials in memory. Without it only errors are held, until they are compared over the cells
        that all trials fill (of a shard until they are written, as `merge_shards` compares them).
    execution:
        As for `sionna_radar.run`; the surveys are a stage, beside those of each.

    Raises
    ------
    BackendError
        The ray tracer cannot run here.
    WorkerError
        The workers are gone, or have another version of the program.

    Examples
    --------
    >>> short = {"platform.length_m": 10.0, "terrain.spacing_m": 2.0}
    >>> plan = plan_sweep("hills", {"radar.snr_db": [20.0, 40.0]}, overrides=short)
    >>> run_sweep(plan).failed
    False
    """
    flights = [flight for number, flight in enumerate(plan.flights()) if shard is None or shard.holds(number)]
    execution = execution or Execution()
    places, tasks = _tasks(flights, execution.block_size, keep_maps)
    flown: dict[Place, Trial | Failure] = {}
    interrupted = False
    steps = {key: len(surveys) for key, surveys in places.items()}
    try:
        with execution.reported(), stage("surveys", len(flights)):
            for key, result in fly_trials(execution, tasks, steps):
                flown |= dict.fromkeys(places[key], result)
    except (KeyboardInterrupt, Interrupted):
        if execution.checkpoints is not None:
            raise
        interrupted = True
    repeats: dict[int, list[int]] = {}
    for number, _, repeat in flights:
        repeats.setdefault(number, []).append(repeat)
    if shard is None:  # otherwise `merge_shards` compares the maps of all shards
        flown = _over_common_cells(flown, keep_maps=keep_maps)
    return Sweep(
        source=plan.source,
        axes=plan.axes,
        repeat=plan.repeat,
        cases=tuple(_case(cell, number, repeats.get(number, ()), flown) for number, cell in enumerate(plan.cells)),
        interrupted=interrupted,
        shard=str(shard or ""),
    )


def _tasks(
    flights: Sequence[tuple[int, Scenario, int]], block_size: int, keep_maps: bool
) -> tuple[dict[str, list[Place]], dict[str, Task]]:
    """Return the cells and seeds of each distinct survey, and the surveys as tasks, both by key."""
    places: dict[str, list[Place]] = {}
    tasks: dict[str, Task] = {}
    for number, scenario, repeat in flights:
        document = scenario.model_copy(update={"seed": scenario.seed + repeat}).model_dump_json()
        key = f"{document} with maps" if keep_maps else document
        places.setdefault(key, []).append((number, repeat))
        tasks[key] = {"scenario": document, "block_size": block_size, "keep_maps": keep_maps}
    return places, tasks


def _case(cell: Cell, number: int, repeats: Sequence[int], flown: Mapping[Place, Trial | Failure]) -> Case:
    trials, reason = [], cell.refusal
    for repeat in repeats:
        outcome = flown.get((number, repeat))
        if isinstance(outcome, Trial):
            trials.append(outcome)
        elif not reason and cell.scenario is not None:
            reason = "interrupted" if outcome is None else failure(outcome, cell.scenario, repeat)
    return Case(setting=cell.setting, scenario=cell.scenario, trials=tuple(trials), reason=reason)


def fly_trials(
    execution: Execution, tasks: Mapping[str, Task], steps: Mapping[str, int] | None = None
) -> Iterator[tuple[str, Trial | Failure]]:
    """Yield the trial of each survey by its key, or its failure; BackendError if the ray tracer cannot run."""
    for key, outcome in execution.over(tasks, trial_task, steps=steps):
        if isinstance(outcome, Failure) and outcome.kind == BackendError.__name__:
            raise outcome.error()
        yield key, outcome if isinstance(outcome, Failure) else trial_of(outcome)


def trial_task(task: Task) -> bytes:
    """Fly the survey of a task, and return its trial and what maps it keeps, packed."""
    scenario = Scenario.model_validate_json(task["scenario"])
    trial = _trial(scenario, Execution(block_size=task["block_size"]), task["keep_maps"])
    return packed(trial=document_bytes(asdict(replace(trial, maps={}))), **trial.maps)


def trial_of(content: bytes) -> Trial:
    """Return the trial that `trial_task` packed, with its maps."""
    columns = columns_of(content)
    maps = {name: table_of(Raster, name, columns) for name in MAPS if f"{name}.height_m" in columns}
    return replace(Trial.of_document(document_of(columns["trial"].item())), maps=maps)


def _trial(scenario: Scenario, execution: Execution, keep_maps: bool) -> Trial:
    survey = run(scenario, execution=execution)
    quantities = asdict(survey.mapped) | ({} if survey.obstacles is None else survey.obstacles.rates())
    return Trial(
        seed=scenario.seed,
        echoes=len(survey.points),
        points_sha256=survey.points.sha256(),
        dem_error=survey.dem_error,
        lit_error=survey.lit_error,
        off_wall_error=survey.off_wall_error,
        warnings=survey.warnings,
        **{name: value for name, value in quantities.items() if np.isfinite(value)},
        stated_sigma_m=_stated_sigma_m(survey),
        flown_s=float(np.ptp(survey.prepared.flight.trajectory.cruise_s())),
        maps=_maps(survey, MAPS if keep_maps else ("error",)),
        wall_s=survey.timing_s["total"],
        peak_memory_mb=survey.peak_memory_mb,
    )


def _stated_sigma_m(survey: Survey) -> float | None:
    if survey.dem_sigma is None:
        return None
    stated = survey.dem_sigma.height_m[survey.lit & survey.dem_sigma.filled]
    return float(np.sqrt(np.mean(stated**2))) if len(stated) else None


def _maps(survey: Survey, names: Sequence[str]) -> dict[str, Raster]:
    lit_error = replace(survey.error, height_m=np.where(survey.lit, survey.error.height_m, np.nan).astype(np.float32))
    maps = dict(zip(MAPS, (survey.dem, survey.dem_sigma, lit_error), strict=True))
    return {name: raster for name, raster in maps.items() if raster is not None and name in names}


def _over_common_cells(flown: Mapping[Place, Trial | Failure], *, keep_maps: bool) -> dict[Place, Trial | Failure]:
    """Return the trials with their errors over the cells that all of them lit and filled, if their cells coincide."""
    trials = {place: trial for place, trial in flown.items() if isinstance(trial, Trial) and trial.maps}
    common = common_rms_m([trial.maps["error"] for trial in trials.values()])
    rms_m: Sequence[float | None] = common or [None] * len(trials)
    compared = {
        place: replace(trial, common_rms_m=rms, maps=trial.maps if keep_maps else {})
        for (place, trial), rms in zip(trials.items(), rms_m, strict=True)
    }
    return {**flown, **compared}


# Largest difference of mapped areas, relative to the larger, between surveys whose errors may be compared as they are.
AREAS_ALIKE = 0.05


def unequal_areas(areas: Sequence[tuple[str, float]]) -> str:
    """Return the sentence about areas, by name, m2, that differ by more than `AREAS_ALIKE`; "" if they do not."""
    known = [(name, area) for name, area in areas if np.isfinite(area)]
    if len(known) < 2:
        return ""
    (least_name, least), (most_name, most) = (pick(known, key=lambda pair: pair[1]) for pick in (min, max))
    if most <= 0 or least >= (1 - AREAS_ALIKE) * most:
        return ""
    return (
        f"mapped areas differ by {1 - least / most:.0%} ({least:,.0f} m2 at {least_name}, {most:,.0f} m2 at "
        f"{most_name}), and an error over fewer cells may be smaller for that alone"
    )


def common_rms_m(errors: Sequence[Raster]) -> list[float] | None:
    """Return the RMS error of each map over the cells that all fill; None if there are none, or do not coincide.

    The maps are reduced one by one, so that no stack of them is held in memory.
    """
    windows = _common_windows(errors)
    if windows is None:
        return None
    common = np.logical_and.reduce([np.isfinite(window) for window in windows])
    if not common.any():
        return None
    return [float(np.sqrt(np.mean(window[common].astype(float) ** 2))) for window in windows]


def _common_windows(maps: Sequence[Raster]) -> list[Float[np.ndarray, "row column"]] | None:
    """Return the part of each map that all have in common; None if their cells do not coincide. NaN in empty cells."""
    if len({raster.grid.spacing_m for raster in maps}) != 1:  # or no maps
        return None
    transforms = np.array([raster.grid.transform for raster in maps])
    # Of the north-west corners: rows to the south, columns to the east.
    corner = np.column_stack([-transforms[:, 5], transforms[:, 2]]) / maps[0].grid.spacing_m
    start = corner.max(axis=0) - corner
    size = np.min([raster.grid.shape - first for raster, first in zip(maps, start, strict=True)], axis=0)
    if np.abs(start - np.round(start)).max() > ALIGNED or size.min() < 0.5:
        return None
    rows, columns = np.round(size).astype(int)
    starts = zip(maps, np.round(start).astype(int), strict=True)
    return [raster.height_m[::-1][row : row + rows, column : column + columns] for raster, (row, column) in starts]


def merge_shards(shards: Sequence[Sweep]) -> Sweep:
    """Return the whole study from its shards, identical to one flown at once.

    Raises InputFileError for shards of different studies, a missing or duplicate one, and for a whole study.
    """
    parsed = [Shard.parse(sweep.shard) for sweep in shards if sweep.shard]
    if len(parsed) < len(shards):
        raise InputFileError("one of the folders holds a whole study, not a shard; leave it out")
    studies = [(s.source, s.axes, s.repeat, [case.scenario for case in s.cases]) for s in shards]
    for study, shard in zip(studies[1:], parsed[1:], strict=True):
        if study != studies[0]:
            raise InputFileError(f"shards {parsed[0]} and {shard} are of different studies; merge those of one")
        if shard.count != parsed[0].count:
            raise InputFileError(f"shards {parsed[0]} and {shard} are of different counts; merge those of one study")
    numbers = [shard.number for shard in parsed]
    twice = sorted({number for number in numbers if numbers.count(number) > 1})
    missing = sorted(set(range(1, parsed[0].count + 1)) - set(numbers))
    if twice:
        raise InputFileError(f"shard {twice[0]}/{parsed[0].count} is there twice; name its folder once")
    if missing:
        listed = ", ".join(f"{number}/{parsed[0].count}" for number in missing)
        raise InputFileError(f"shard {listed} is missing; name its folder, too")
    cases = [_merged(same) for same in zip(*(sweep.cases for sweep in shards), strict=True)]
    flown: dict[Place, Trial | Failure] = {
        (number, repeat): trial for number, case in enumerate(cases) for repeat, trial in enumerate(case.trials)
    }
    flown = _over_common_cells(flown, keep_maps=False)
    compared = [
        replace(case, trials=tuple(t for place, t in flown.items() if place[0] == number and isinstance(t, Trial)))
        for number, case in enumerate(cases)
    ]
    return replace(shards[0], cases=tuple(compared), shard="")


def _merged(cases: Sequence[Case]) -> Case:
    trials = sorted((trial for case in cases for trial in case.trials), key=lambda trial: trial.seed)
    return replace(cases[0], trials=tuple(trials), reason=next((case.reason for case in cases if case.reason), ""))
