"""Trials of a study: one survey each, its statistics by name, and flights as tasks for workers."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from scipy.stats import norm

from sionna_radar.accuracy.compare import DemError
from sionna_radar.execution.execution import Execution
from sionna_radar.execution.workers import Failure, Task, document_bytes, document_of
from sionna_radar.foundation.columns import columns_of, packed, table_of
from sionna_radar.foundation.errors import BackendError
from sionna_radar.foundation.raster import Raster
from sionna_radar.scenario import Scenario
from sionna_radar.survey.chain import run
from sionna_radar.survey.result import Survey

# Maps of a trial, by the names of their files.
MAPS = ("dem", "dem_sigma", "error")
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
