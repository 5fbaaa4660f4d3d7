"""The folder of a cross-check."""

import math
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from sionna_radar.report.crosscheck.figures import draw_all
from sionna_radar.report.folder import without_nan, write_study
from sionna_radar.studies.crosscheck_result import CrossCheck

MARKER = "crosscheck.json"
SPECKLE = (
    "Powers are sums of |gain|^2 over a pulse's paths, free of speckle. The DEMs are not: two seeds of one "
    "engine already differ. dem_rms_difference_m is over all four pairs of a Sionna and a gamma run; "
    "dem_speckle_rms_m, over the pairs of one engine, is the part due to speckle alone; dem_probability is the "
    "probability of such a difference by speckle alone (randomisation test over dem_tiles tiles of the map)."
)
SHARED = (
    "Both engines share the ray casting, the antenna, the backscatter models, the point targets and the mirror "
    "reflections; the cross-check does not test those."
)


def write_crosscheck(check: CrossCheck, directory: Path) -> list[Path]:
    """Write `crosscheck.json` and the figures into a directory, all or nothing, and return the files.

    Raises
    ------
    OutputError
        The directory holds something else, or cannot be written; see `write_folder`.

    """
    return write_study(directory, MARKER, crosscheck_summary(check), partial(draw_all, check))


def crosscheck_summary(check: CrossCheck) -> dict[str, Any]:
    """Return the numbers of the comparison in strict JSON form; a number that does not exist is None."""
    again = check.sionna_again.echo_range_m
    document: dict[str, Any] = {
        "agrees": check.agrees,
        "mean_power_difference_db": check.mean_power_difference_db,
        "p95_abs_power_difference_db": check.p95_abs_power_difference_db,
        "mean_power_scatter_db": check.mean_power_scatter_db,
        "p95_power_scatter_db": check.p95_power_scatter_db,
        "power_difference_db": _spread(check.power_difference_db),
        "power_trend_db_per_10deg": check.power_trend_db_per_10deg(),
        "power_by_incidence": [asdict(entry) for entry in check.by_incidence()],
        "range_difference_m": _spread(check.gamma.range_m - check.sionna.range_m),
        "echo_range_difference_m": _spread(check.gamma.echo_range_m - check.sionna.echo_range_m),
        "echo_range_difference_of_seeds_m": _spread(again - check.sionna.echo_range_m),
        "dem_rms_difference_m": check.dem_rms_difference_m,
        "dem_mean_difference_m": check.mean_m(),
        "dem_speckle_rms_m": check.dem_speckle_rms_m,
        "dem_probability": check.dem_test.probability,
        "dem_tiles": check.dem_test.tiles,
        "dem_rms_of_sionna_seeds_m": check.rms_m(check.sionna_again, check.sionna),
        "dem_rms_of_gamma_seeds_m": check.rms_m(check.gamma_again, check.gamma),
        "dem_cells": int(check.common().sum()),
        "pulses": len(check.sionna.power),
        "seeds": [check.sionna.seed, check.sionna_again.seed],
        "tolerances": asdict(check.tolerances),
        "verdict": check.verdict(),
        "speckle": SPECKLE,
        "shared": SHARED,
        "scenario": check.scenario.model_dump(mode="json"),
    }
    return without_nan(document)


def _spread(values: Float[np.ndarray, " n"]) -> dict[str, float]:
    """Return the centre and the width of a distribution, without and with outliers."""
    known = values[np.isfinite(values)]
    if len(known) == 0:
        return dict.fromkeys(("mean", "std", "median", "p95_abs"), math.nan)
    return {
        "mean": float(known.mean()),
        "std": float(known.std()),
        "median": float(np.median(known)),
        "p95_abs": float(np.percentile(np.abs(known), 95)),
    }
