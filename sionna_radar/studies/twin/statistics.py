"""Statistics of a recording beside its simulation, tested together.

Each row is a statistic of the pulses, such as the mean noise floor, with its difference, measured minus simulated. Were
the two alike, their labels could be exchanged over any part of the ground: a permutation test exchanges them in blocks,
tiles of the ground, which respects correlation within a tile, along the track or across it. It takes the greatest
standardised difference of all rows (Westfall and Young 1993, "Resampling-based multiple testing", single-step maxT), so
that the stated false-alarm rate is that of all rows together.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import uniform_filter1d

from sionna_radar.foundation.numerics import MAD_SIGMA
from sionna_radar.radar.chirp import Chirp

# Probability that any row differs by chance.
FALSE_ALARM = 0.01
EXCHANGES = 1999
# Pulses over which the mean power of the echo is taken to be constant.
LEVEL_PULSES = 33
# Edges of incidence, deg, and least pulses in a bin.
INCIDENCE_DEG = (0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 90.0)
MIN_PULSES = 50
# Range errors beyond this multiple of their normalised median deviation are tails.
TAIL_NMAD = 5.0
# Mean leakage over the floor from which it is a row of its own.
LEAKAGE_SEEN = 2.0
# Standard deviation of a point's power about its range, in range cells, seen through the usual window (Hann).
POINT_CELLS = 0.65


@dataclass(frozen=True, kw_only=True)
class Row:
    """A statistic of the recording beside that of its simulation.

    unit: of the values. sigma: standard deviation of the difference between two that are alike.
    p: probability of so large a difference in any row between two that are alike.
    needs: what would make up for the difference; empty where it is not significant.
    """

    name: str
    unit: str
    measured: float
    simulated: float
    sigma: float
    p: float
    needs: str

    @property
    def difference(self) -> float:
        """Measured minus simulated."""
        return self.measured - self.simulated

    @property
    def differs(self) -> bool:
        """Whether the two differ at the stated rate of false alarms."""
        return self.p <= FALSE_ALARM


@dataclass(frozen=True, kw_only=True)
class Look:
    """Where the echo of each pulse is expected: the same for both sides.

    range_m: along the boresight; infinite where it meets nothing. bin: of the spectrum, with the Doppler shift.
    incidence_deg: on the surface there; cover: its name. echo_m: half-width of the echo's cells.
    """

    range_m: Float[np.ndarray, " pulse"]
    bin: Float[np.ndarray, " pulse"]
    incidence_deg: Float[np.ndarray, " pulse"]
    cover: np.ndarray
    echo_m: float


@dataclass(frozen=True, kw_only=True)
class Side:
    """What one side says of each pulse.

    floor, leakage: mean power in their cells. about: power about the expected range, NaN beyond the spectrum.
    power_db, error_m: of the strongest echo of each pulse, its range minus the expected one; NaN without an echo.
    """

    floor: Float[np.ndarray, " pulse"]
    leakage: Float[np.ndarray, " pulse"]
    about: Float[np.ndarray, "pulse cell"]
    power_db: Float[np.ndarray, " pulse"]
    error_m: Float[np.ndarray, " pulse"]

    @property
    def silent(self) -> Bool[np.ndarray, " pulse"]:
        """Pulses without an echo."""
        return np.isnan(self.power_db)

    def counted_from_floor(self) -> "Side":
        """Return it with all powers over the mean floor, for samples in an unknown unit."""
        unit = float(self.floor.mean())
        return replace(
            self,
            floor=self.floor / unit,
            leakage=self.leakage / unit,
            about=self.about / unit,
            power_db=self.power_db - 10 * np.log10(unit),
        )


Sums = Float[np.ndarray, "... sum"]


@dataclass(frozen=True, kw_only=True)
class Statistic:
    """A statistic of one side, as a function of sums over pulses, and what its difference would need.

    of: returns it from sums over the last axis. measured, simulated: terms of the sums, per item; NaN where one has no
    say. block: of each item.
    """

    name: str
    unit: str
    of: Callable[[Sums], Float[np.ndarray, " ..."]]
    measured: Float[np.ndarray, "item sum"]
    simulated: Float[np.ndarray, "item sum"]
    block: Int[np.ndarray, " item"]
    needs: Callable[[float, float], str]

    def sums(self, blocks: int) -> tuple[Float[np.ndarray, "block sum"], Float[np.ndarray, "block sum"]]:
        """Return the sums of the blocks, measured and simulated."""
        totals = []
        for terms in (self.measured, self.simulated):
            known = np.isfinite(terms).all(axis=1)
            total = np.zeros((blocks, terms.shape[1]))
            np.add.at(total, self.block[known], terms[known])
            totals.append(total)
        return totals[0], totals[1]


def _mean(sums: Sums) -> Float[np.ndarray, " ..."]:
    return sums[..., 1] / sums[..., 0]


def _level(sums: Sums) -> Float[np.ndarray, " ..."]:
    return 10 * np.log10(_mean(sums))


def _deviation(sums: Sums) -> Float[np.ndarray, " ..."]:
    mean = _mean(sums)
    return np.sqrt(np.maximum(sums[..., 2] / sums[..., 0] - mean**2, 0.0))


def _correlation(sums: Sums) -> Float[np.ndarray, " ..."]:
    """Return the correlation of neighbours: sums of one, x, x squared and the product of a pair."""
    return (sums[..., 3] / sums[..., 0] - _mean(sums) ** 2) / _deviation(sums) ** 2


def _width(sums: Sums) -> Float[np.ndarray, " ..."]:
    """Return the deviation of power about its mean range, from its sums with powers 0, 1 and 2 of the offset."""
    power = sums[..., 0]
    return np.sqrt(np.maximum(sums[..., 2] / power - (sums[..., 1] / power) ** 2, 0.0))


def _slope(sums: Sums) -> Float[np.ndarray, " ..."]:
    """Return the slope of y over x: sums of one, x, x squared, y and their product."""
    mean = _mean(sums)
    covariance = sums[..., 4] / sums[..., 0] - mean * sums[..., 3] / sums[..., 0]
    return covariance / (sums[..., 2] / sums[..., 0] - mean**2)


def _ones(values: Float[np.ndarray, " item"], *further: Float[np.ndarray, " item"]) -> Float[np.ndarray, "item sum"]:
    return np.stack([np.ones(len(values)), values, *further], axis=1)


def _in_pairs(values: Float[np.ndarray, " pulse"], scan: Int[np.ndarray, " pulse"] | None) -> np.ndarray:
    """Return the terms of the correlation of consecutive pulses of one scan."""
    following = np.append(values[1:], np.nan)
    if scan is not None:
        following[:-1][np.diff(scan) != 0] = np.nan
    mean, square = (values + following) / 2, (values**2 + following**2) / 2
    return _ones(mean, square, values * following)


def rows_of(statistics: list[Statistic], blocks: int, seed: int) -> tuple[Row, ...]:
    """Return the rows of statistics, tested together."""
    exchanged = np.random.default_rng(seed).random((EXCHANGES, blocks)) < 0.5
    observed, spread, greatest = [], [], np.zeros(EXCHANGES)
    with np.errstate(all="ignore"):
        for statistic in statistics:
            measured, simulated = statistic.sums(blocks)
            kept = np.where(exchanged[:, :, None], simulated, measured).sum(axis=1)
            gap = statistic.of(kept) - statistic.of((measured + simulated).sum(axis=0) - kept)
            # Not a number where no exchange leaves both sides anything to compare.
            sigma = float(np.sqrt(np.nanmean(gap**2))) if np.isfinite(gap).any() else float("nan")
            one, other = (float(statistic.of(side.sum(axis=0, keepdims=True))[0]) for side in (measured, simulated))
            observed.append((one, other))
            spread.append(sigma)
            greatest = np.fmax(greatest, np.abs(gap) / sigma if sigma > 0 else 0.0)
    rows = []
    for statistic, (one, other), sigma in zip(statistics, observed, spread, strict=True):
        if not np.isfinite([one, other, sigma]).all():
            continue
        score = abs(one - other) / sigma if sigma > 0 else 0.0
        p = float(1 + np.count_nonzero(greatest >= score)) / (1 + EXCHANGES) if score > 0 else 1.0
        needs = statistic.needs(one, other) if p <= FALSE_ALARM else ""
        rows.append(
            Row(name=statistic.name, unit=statistic.unit, measured=one, simulated=other, sigma=sigma, p=p, needs=needs)
        )
    return tuple(rows)


def _in_quadrature(what: str) -> Callable[[float, float], str]:
    def needs(measured: float, simulated: float) -> str:
        rest = float(np.sqrt(abs(measured**2 - simulated**2)))
        return f"{what} of {rest:.3f} m {'more' if measured > simulated else 'less'}, in quadrature"

    return needs


def _decibels(what: str) -> Callable[[float, float], str]:
    return lambda measured, simulated: f"{what} {measured - simulated:+.1f} dB"


Terms = Callable[[Side], Float[np.ndarray, "item sum"]]
Needs = Callable[[float, float], str]


@dataclass(frozen=True, kw_only=True)
class Pair:
    """Both sides, by pulses.

    block: of each pulse. scan: of the antenna that each belongs to; None for a continuous scan.
    bin_m, chirp, beam_rad: bins of the spectra, the sweep, and the simulated beam.
    levels_known: whether both have their powers in the same unit.
    """

    measured: Side
    simulated: Side
    look: Look
    block: Int[np.ndarray, " pulse"]
    scan: Int[np.ndarray, " pulse"] | None
    bin_m: float
    chirp: Chirp
    beam_rad: float
    levels_known: bool

    @property
    def sides(self) -> tuple[Side, Side]:
        """Measured and simulated."""
        return self.measured, self.simulated

    def row(self, name: str, unit: str, of: Callable[[Sums], Any], terms: Terms, needs: Needs) -> Statistic:
        """Return a statistic of the pulses."""
        return Statistic(
            name=name,
            unit=unit,
            of=of,
            measured=terms(self.measured),
            simulated=terms(self.simulated),
            block=self.block,
            needs=needs,
        )

    def offset_m(self) -> Float[np.ndarray, "pulse cell"]:
        """Return the distance of the cells about the expected range from it."""
        reach = self.measured.about.shape[1] // 2
        fraction = np.nan_to_num(self.look.bin - np.rint(self.look.bin))
        return (np.arange(-reach, reach + 1) - fraction[:, None]) * self.bin_m


def power_rows(pair: Pair) -> list[Statistic]:
    """Return the statistics of floor, leakage, and the level of echoes by incidence and by cover."""
    rows = []
    if pair.levels_known:
        needs = _decibels("noise figure, or gain,")
        rows.append(pair.row("noise floor", "dB", _level, lambda side: _ones(side.floor), needs))
    if any(np.nanmean(side.leakage) > LEAKAGE_SEEN * side.floor.mean() for side in pair.sides):
        rows.append(pair.row("leakage", "dB", _level, lambda side: _ones(side.leakage), _decibels("leakage")))
    incidence_deg, cover = pair.look.incidence_deg, pair.look.cover
    classes = {
        f"at {low:.0f} to {high:.0f} deg": (incidence_deg >= low) & (incidence_deg < high)
        for low, high in pairwise(INCIDENCE_DEG)
    }
    covers = [name for name in np.unique(cover) if name]
    classes |= {f"over {name}": cover == name for name in (covers if len(covers) > 1 else [])}
    for where, inside in classes.items():
        if min(np.count_nonzero(inside & ~side.silent) for side in pair.sides) < MIN_PULSES:
            continue

        def levels(side: Side, inside: Bool[np.ndarray, " pulse"] = inside) -> Float[np.ndarray, "item sum"]:
            return _ones(np.where(inside, side.power_db, np.nan))

        needs = _decibels("backscatter (gamma), or twice the gain,")
        rows.append(pair.row(f"echo power {where}", "dB", _mean, levels, needs))
    return rows


def shape_rows(pair: Pair) -> list[Statistic]:
    """Return the statistics of the echo's width, of what is beside it, and of its speckle."""
    offset_m = pair.offset_m()
    inside = np.abs(offset_m) <= pair.look.echo_m

    def excess(side: Side) -> Float[np.ndarray, "pulse cell"]:
        return side.about - side.floor.mean()

    def moments(side: Side) -> Float[np.ndarray, "item sum"]:
        power = np.where(inside, excess(side), 0.0)
        return np.stack([(power * offset_m**order).sum(axis=1) for order in range(3)], axis=1)

    def beam(measured: float, simulated: float) -> str:
        alone = (pair.chirp.range_resolution_m * POINT_CELLS) ** 2
        seen, made = (max(width**2 - alone, 0.0) for width in (measured, simulated))
        return f"beam of {np.rad2deg(pair.beam_rad) * np.sqrt(seen / made):.2f} deg" if made > 0 else "a wider beam"

    def beside(side: Side) -> Float[np.ndarray, "item sum"]:
        power = excess(side)
        return np.stack([np.where(inside, power, 0.0).sum(1), np.where(inside, 0.0, power).sum(1)], axis=1)

    def follows(side: Side) -> Float[np.ndarray, "item sum"]:
        power = np.where(inside, excess(side), 0.0).sum(axis=1)
        # About their means: exchanged blocks of another level would hide the slope.
        power, floor = power - np.nanmean(power), side.floor - side.floor.mean()
        return _ones(power, power**2, floor, floor * power)

    def skirt(measured: float, simulated: float) -> str:
        what = "phase noise or side lobes"
        return f"{what} {10 * np.log10(measured / simulated):+.1f} dB" if min(measured, simulated) > 0 else what

    whole = [np.where(inside, excess(side), 0.0).sum(axis=1) for side in pair.sides]
    whole = [power / np.nanmean(power) for power in whole]
    # Both sides' echoes tell how strong an echo is expected.
    level = uniform_filter1d(np.nan_to_num(whole[0] + whole[1]) / 2, LEVEL_PULSES, mode="nearest")
    speckle = {id(side): power / level for side, power in zip(pair.sides, whole, strict=True)}
    return [
        pair.row("echo width", "m", _width, moments, beam),
        pair.row("floor that follows the echo", "share", _slope, follows, skirt),
        pair.row("power beside the echo", "share", lambda sums: sums[..., 1] / sums[..., 0], beside, skirt),
        pair.row(
            "speckle contrast",
            "",
            lambda sums: _deviation(sums) / _mean(sums),
            lambda side: _ones(speckle[id(side)], speckle[id(side)] ** 2),
            lambda measured, simulated: f"{(simulated / measured) ** 2:.2f} times the independent powers in an echo",
        ),
        pair.row(
            "speckle correlation",
            "",
            _correlation,
            lambda side: _in_pairs(speckle[id(side)], pair.scan),
            lambda measured, simulated: f"correlation {measured - simulated:+.2f}: speckle, motion, or the beam's step",
        ),
    ]


def range_rows(pair: Pair) -> list[Statistic]:
    """Return the statistics of silence and range errors."""
    pooled = np.concatenate([side.error_m for side in pair.sides])
    pooled = pooled[np.isfinite(pooled)]
    rows = [
        pair.row(
            "pulses without an echo",
            "%",
            _mean,
            lambda side: _ones(100.0 * side.silent),
            lambda measured, simulated: f"{measured - simulated:+.1f} % of the pulses: level, threshold, or cover",
        )
    ]
    if len(pooled) < MIN_PULSES:
        return rows
    middle = float(np.median(pooled))
    limit = TAIL_NMAD * MAD_SIGMA * float(np.median(np.abs(pooled - middle)))

    def core(side: Side) -> Float[np.ndarray, " pulse"]:
        return np.where(np.abs(side.error_m - middle) <= limit, side.error_m, np.nan)

    def tails(side: Side) -> Float[np.ndarray, "item sum"]:
        return _ones(np.where(side.silent, np.nan, 100.0 * (np.abs(side.error_m - middle) > limit)))

    return [
        *rows,
        pair.row(
            "range bias",
            "m",
            _mean,
            lambda side: _ones(core(side)),
            lambda measured, simulated: f"range_zero_m {measured - simulated:+.3f} m",
        ),
        pair.row(
            "range spread",
            "m",
            _deviation,
            lambda side: _ones(core(side), core(side) ** 2),
            _in_quadrature("range noise"),
        ),
        pair.row(
            "range tails",
            "%",
            _mean,
            tails,
            lambda measured, simulated: f"{measured - simulated:+.1f} % of the echoes: clutter, mirrors, or cover",
        ),
        pair.row(
            "range correlation",
            "",
            _correlation,
            lambda side: _in_pairs(core(side), pair.scan),
            lambda measured, simulated: f"correlation {measured - simulated:+.2f}: a tracker, poses, or relief",
        ),
    ]


def dem_rows(
    measured_m: Float[np.ndarray, " cell"],
    simulated_m: Float[np.ndarray, " cell"],
    block: Int[np.ndarray, " cell"],
    down: float,
) -> list[Statistic]:
    """Return the statistics of the errors of two DEMs in common cells, each in the block of the nearest pulse."""
    if np.count_nonzero(np.isfinite(measured_m)) < MIN_PULSES:
        return []

    def bias(measured: float, simulated: float) -> str:
        # Ground that lies too high was read too near.
        higher_m = measured - simulated
        return f"heights of the datum {higher_m:+.3f} m, or range_zero_m {-higher_m / down:+.3f} m"

    sides = [_ones(error_m, error_m**2) for error_m in (measured_m, simulated_m)]
    rows = (("DEM bias", _mean, bias), ("DEM spread", _deviation, _in_quadrature("errors")))
    return [
        Statistic(name=name, unit="m", of=of, measured=sides[0], simulated=sides[1], block=block, needs=needs)
        for name, of, needs in rows
    ]
