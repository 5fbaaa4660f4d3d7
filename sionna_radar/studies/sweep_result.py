"""What a study returns: trials, the cases that they are of, and the statistics of these."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from sionna_radar.accuracy.compare import DemError
from sionna_radar.foundation.brief import Brief
from sionna_radar.scenario import Scenario
from sionna_radar.studies.design import Axis
from sionna_radar.studies.sweep_plan import label

# Cases that `repr` names.
MAX_LINES = 8
# Statistics by their names in the results: whose cells they are of, and what of their `DemError`.
STATISTICS = {
    **{name: ("lit_error", name) for name in ("rms_m", "mean_m", "std_m", "nmad_m", "min_m", "max_m", "coverage")},
    "off_wall_rms_m": ("off_wall_error", "rms_m"),
    "all_cells_rms_m": ("dem_error", "rms_m"),
}


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One survey of a sweep; its errors are those of `Survey`.

    wall_s, peak_memory_mb: what it took; no two flights take the same, so that these make no difference.
    """

    seed: int
    echoes: int
    points_sha256: str
    dem_error: DemError
    lit_error: DemError
    off_wall_error: DemError | None
    warnings: tuple[str, ...]
    wall_s: float = field(compare=False)
    peak_memory_mb: float = field(compare=False)

    @staticmethod
    def of_document(found: Mapping[str, Any]) -> "Trial":
        """Return the trial that `asdict` made a document of."""
        errors = {
            name: None if found[name] is None else DemError(**found[name])
            for name in ("dem_error", "lit_error", "off_wall_error")
        }
        return Trial(**{**found, **errors, "warnings": tuple(found["warnings"])})


@dataclass(frozen=True, kw_only=True)
class Case:
    """One setting of the varied keys, with its trials; `reason` says why some or all are missing."""

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
    cases: one for each setting.
    interrupted: whether an interrupt ended it.
    shard: which part of the study it is, as I/N; "" for the whole.

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
    shard: str = ""

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
