"""Accuracy of altimeter readings, by a beam that does not scan, against the true clearance.

A reading r(t) that is late by L reads what was true before: r(t) = h(t - L) + b + errors. L is the lag of least
squares, which is that of the largest cross-correlation of readings and heights where their spreads are alike. It is
found by Gauss-Newton steps from L = 0: to first order r(t) - h(t - L) changes by h'(t - L) per second of lag.
Neighbouring errors are alike; the standard deviation is that of lags without one of eight stretches of the flight
(`accuracy.robust_errors`). Over level ground, flown level, h' is zero and a lag is not observable.
"""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from sionna_radar.accuracy.robust_errors import BLOCKS, blocks_of, robust_fit

# Fewest readings of a stretch, of which a lag is estimated.
LEAST_IN_STRETCH = 5
MAX_STEPS = 20


@dataclass(frozen=True, kw_only=True)
class ReadingErrors:
    """Readings minus the true height, m; NaN without readings.

    pulses, drop_outs: number of pulses, and of those without a reading.
    bias_m, std_m: mean and standard deviation of the errors; le95_m: 95th percentile of |error|.
    lowest_clearance_m: least height of the radar over what stands below it.
    """

    pulses: int
    drop_outs: int
    bias_m: float
    std_m: float
    le95_m: float
    lowest_clearance_m: float


@dataclass(frozen=True, kw_only=True)
class Readings:
    """Readings of a survey, one row for each pulse.

    along: what is read: the height above the ground straight below ("vertical"), or the distance to the surface along
        the axis of a beam that does not reach straight down ("axis").
    time_s: of each pulse. reading_m: NaN for a drop-out. true_m: what was to be read, NaN beyond the terrain.
    clearance_m: height over whatever stands straight below, plants and buildings included.
    cover: what is straight below, by name.
    errors: of all pulses; by_cover: of those over each cover.
    longest_drop_out_s: longest time between two readings, or between one and the start or end, less one interval.
    latency_s, latency_sigma_s: lag of the readings behind the true heights, positive for late ones, and its standard
        deviation; None where it is not observable.
    by_readings_m: lowest clearance of the same flight steered by these readings instead of by the true ground; None for
        a flight that is not steered by what is sensed (`platform.height = "sensed"`).
    """

    along: str
    time_s: Float[np.ndarray, " pulse"]
    reading_m: Float[np.ndarray, " pulse"]
    true_m: Float[np.ndarray, " pulse"]
    clearance_m: Float[np.ndarray, " pulse"]
    cover: tuple[str, ...]
    errors: ReadingErrors
    by_cover: dict[str, ReadingErrors]
    longest_drop_out_s: float
    latency_s: float | None
    latency_sigma_s: float | None
    by_readings_m: float | None = None

    @property
    def subject(self) -> str:
        """What is read, in words."""
        return "height above ground" if self.along == "vertical" else "distance along the axis"

    def document(self) -> dict[str, Any]:
        """Return the statistics as nested tables."""
        per_pulse = ("time_s", "reading_m", "true_m", "clearance_m", "cover")
        return {name: value for name, value in asdict(self).items() if name not in per_pulse}

    def described(self) -> dict[str, str]:
        """Return the statistics by their names, in words."""
        total = self.errors
        rows = {f"reading less {self.subject}": _words(total)}
        if len(self.by_cover) > 1:
            rows |= {f"  over {name!r}": _words(errors) for name, errors in self.by_cover.items()}
        drop_out_fraction = total.drop_outs / max(total.pulses, 1)
        longest = f", the longest {self.longest_drop_out_s:.3g} s" if total.drop_outs else ""
        rows["drop-outs"] = f"{total.drop_outs:,} of {total.pulses:,} pulses ({drop_out_fraction:.1%}){longest}"
        rows["latency"] = "not observable: the heights vary too little"
        if self.latency_s is not None:
            rows["latency"] = f"{self.latency_s:+.3f} ± {self.latency_sigma_s:.3f} s (positive: late)"
        rows["lowest clearance flown"] = f"{total.lowest_clearance_m:.2f} m over what stands below"
        if len(self.by_cover) > 1:
            over = (f"{errors.lowest_clearance_m:.2f} m over {name!r}" for name, errors in self.by_cover.items())
            rows["lowest clearance flown"] += f": {', '.join(over)}"
        if self.by_readings_m is not None:
            rows["lowest clearance, steered by these readings"] = f"{self.by_readings_m:.2f} m"
        return rows


def _words(errors: ReadingErrors) -> str:
    if not np.isfinite(errors.bias_m):
        return "no reading"
    return f"bias {errors.bias_m:+.2f} m, spread {errors.std_m:.2f} m, 95 % within {errors.le95_m:.2f} m"


def readings_of(
    along: str,
    time_s: Float[np.ndarray, " pulse"],
    reading_m: Float[np.ndarray, " pulse"],
    true_m: Float[np.ndarray, " pulse"],
    clearance_m: Float[np.ndarray, " pulse"],
    cover: tuple[str, ...],
    by_readings_m: float | None = None,
) -> Readings:
    """Return the readings of a survey with their statistics; see `Readings`."""
    error_m, names = reading_m - true_m, np.array(cover)
    lag = latency(time_s, reading_m, true_m)
    return Readings(
        along=along,
        time_s=time_s,
        reading_m=reading_m,
        true_m=true_m,
        clearance_m=clearance_m,
        cover=cover,
        errors=_errors(error_m, np.isnan(reading_m), clearance_m),
        by_cover={
            name: _errors(error_m[of_cover], np.isnan(reading_m[of_cover]), clearance_m[of_cover])
            for name in sorted(set(cover))
            for of_cover in [names == name]
        },
        longest_drop_out_s=_longest_gap_s(time_s, np.isfinite(reading_m)),
        latency_s=None if lag is None else lag[0],
        latency_sigma_s=None if lag is None else lag[1],
        by_readings_m=by_readings_m,
    )


def _errors(
    error_m: Float[np.ndarray, " pulse"], dropped: Bool[np.ndarray, " pulse"], clearance_m: Float[np.ndarray, " pulse"]
) -> ReadingErrors:
    valid = error_m[np.isfinite(error_m)]
    some = valid if len(valid) else np.array([np.nan])
    over = clearance_m[np.isfinite(clearance_m)]
    return ReadingErrors(
        pulses=len(error_m),
        drop_outs=int(dropped.sum()),
        bias_m=float(some.mean()),
        std_m=float(some.std()),
        le95_m=float(np.percentile(np.abs(some), 95)),
        lowest_clearance_m=float(over.min()) if len(over) else float("nan"),
    )


def _longest_gap_s(time_s: Float[np.ndarray, " pulse"], read: Bool[np.ndarray, " pulse"]) -> float:
    """Return the longest time without a reading where pulses were sent; 0 where each has one."""
    if len(time_s) < 2 or read.all():
        return 0.0
    interval_s = float(np.median(np.diff(time_s)))
    at_s = np.concatenate([[time_s[0] - interval_s], time_s[read], [time_s[-1] + interval_s]])
    return float(max(np.diff(at_s).max() - interval_s, 0.0))


def latency(
    time_s: Float[np.ndarray, " pulse"], reading_m: Float[np.ndarray, " pulse"], true_m: Float[np.ndarray, " pulse"]
) -> tuple[float, float] | None:
    """Return the lag of readings behind the true heights, and its standard deviation, s.

    None where the heights vary too little to determine it to within a tenth of the flight, and with too few readings.
    """
    whole = np.isfinite(true_m)
    used = whole & np.isfinite(reading_m)
    if used.sum() < BLOCKS * LEAST_IN_STRETCH:
        return None
    known_s, known_m = time_s[whole], true_m[whole]
    slope_mps = np.gradient(known_m, known_s)
    longest_s, lag_s = float(np.ptp(known_s)) / 10, 0.0
    for _ in range(MAX_STEPS):
        before_s = time_s - lag_s
        here = used & (before_s >= known_s[0]) & (before_s <= known_s[-1])
        left_m = reading_m[here] - np.interp(before_s[here], known_s, known_m)
        model = np.column_stack([np.ones(len(left_m)), -np.interp(before_s[here], known_s, slope_mps)])
        fit = robust_fit(model, model, left_m, blocks_of(time_s[here, None]))
        if not np.isfinite(fit.sigma).all():
            return None
        lag_s += float(fit.estimate[1])
        if not abs(lag_s) < longest_s:
            return None
        if abs(fit.estimate[1]) < 1e-6:
            break
    sigma_s = float(fit.sigma[1])
    return (lag_s, sigma_s) if 2 * sigma_s < longest_s else None
