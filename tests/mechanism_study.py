"""What each mechanism of the maps of natural ground wins: the same echoes are mapped with it, and with it switched off.

Off means: the simplest thing in its place (no amplitude, all heights, one covariance), put there by a monkeypatch.
"""

import ast
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sionna_radar import load_scenario
from sionna_radar.execution.execution import Execution
from sionna_radar.mapping import mapper
from sionna_radar.mapping.build import build_dem_method
from sionna_radar.survey.observation import observe
from sionna_radar.survey.placement import place
from sionna_radar.survey.preparation import prepare

PACKAGE = Path(mapper.__file__).parents[1]
METHODS = ("linear", "smooth", "refined")
NOMINAL = {68: 0.9945, 90: 1.6449, 95: 1.9600}  # intervals in percent, and half their widths in standard deviations
STEEP_RAD, STEEP_CELLS = np.deg2rad(10), 200
# What earns a place: of the RMS error; points of coverage, or of an interval.
LEAST_RMS, LEAST_POINTS = 0.05, 2.0


@dataclass(frozen=True)
class Mechanism:
    """Something that maps could do without.

    where: modules of the program, or functions, classes and constants in them, that would go with it.
    off: puts the simplest thing in its place; options: of the method, instead.
    """

    name: str
    sentence: str
    where: tuple[str, ...]
    off: Callable[[pytest.MonkeyPatch], None] = lambda _: None
    methods: tuple[str, ...] = METHODS
    options: tuple[tuple[str, Any], ...] = ()

    @property
    def lines(self) -> int:
        """How many lines of the program it takes."""
        return sum(_lines(place) for place in self.where)


def _lines(place: str) -> int:
    path = PACKAGE.joinpath(*place.split(".")).with_suffix(".py")
    if path.exists():
        return len(path.read_text(encoding="utf-8").splitlines())
    module, *names = place.rsplit(".", 2 if place.split(".")[-2][:1].isupper() else 1)
    found: Any = ast.parse(PACKAGE.joinpath(*module.split(".")).with_suffix(".py").read_text(encoding="utf-8"))
    for name in names:
        found = next(node for node in found.body if name in _names(node))
    return int(found.end_lineno - found.lineno + 1)


def _names(node: ast.stmt) -> Iterator[str]:
    targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", node)]
    for target in targets:
        for each in target.elts if isinstance(target, ast.Tuple) else [target]:
            yield getattr(each, "id", getattr(each, "name", ""))


@dataclass(frozen=True)
class Score:
    """Of one map: RMS error, m, share of the lit cells that are filled, time; shares of the cells in each interval."""

    rms_m: float
    filled: float
    seconds: float
    held: dict[str, float]


class Flight:
    """The echoes of a survey, kept to be mapped again."""

    def __init__(self, changes: dict[str, Any]) -> None:
        self.prepared = prepare(load_scenario("own_dem", {"dem.method": "refined"} | changes))
        sensor, self.observed = observe(self.prepared, Execution())
        self.points = place(self.observed.echoes, sensor, self.prepared.flight)
        truth = self.prepared.truth.surface
        north, east = np.gradient(truth.height_m, truth.grid.spacing_m)
        self.steep = np.arctan(np.hypot(north, east)) > STEEP_RAD

    def score(self, method: str, options: tuple[tuple[str, Any], ...] = ()) -> Score:
        """The score of a map."""
        table = self.prepared.local.dem
        given = {"method": method} | ({"method_parameters": dict(options)} if options else {})
        table = type(table).model_validate(table.model_dump(exclude={"method_parameters"}) | given)
        begin = time.perf_counter()
        made = replace(self.prepared.mapper, method=build_dem_method(table), name=method).map(
            self.points, self.observed.profiles, self.prepared.measured
        )
        seconds = time.perf_counter() - begin
        lit = self.observed.hits.lit & self.prepared.truth.surface.filled
        error = (made.dem.height_m - self.prepared.truth.surface.height_m)[lit]
        sigma, steep, known = made.sigma.height_m[lit], self.steep[lit], np.isfinite(error)
        held = {}
        for name, which in {"all": known, "steep": known & steep}.items():
            if name == "all" or which.sum() >= STEEP_CELLS:
                z = np.abs(error[which] / sigma[which])
                held |= {f"{name} {percent}": float(100 * np.mean(z <= width)) for percent, width in NOMINAL.items()}
        return Score(float(np.sqrt(np.mean(error[known] ** 2))), 100 * float(known.mean()), seconds, held)


@dataclass(frozen=True)
class Gain:
    """What a mechanism wins on one world by one method, in all seeds together; what not all seeds agree in is 0.

    rms: of the error without it; filled, interval: points; which: the interval that it brings nearest to its name.
    slower: the ratio of the times.
    """

    rms: float
    filled: float
    interval: float
    which: str
    slower: float

    @property
    def earned(self) -> bool:
        """Whether it wins enough."""
        return self.rms >= LEAST_RMS or max(self.filled, self.interval) >= LEAST_POINTS

    @property
    def greatest(self) -> float:
        """Its greatest gain, in what is enough."""
        return max(self.rms / LEAST_RMS, self.filled / LEAST_POINTS, self.interval / LEAST_POINTS)


def gain(on: list[Score], off: list[Score]) -> Gain:
    """What a mechanism wins: scores of each seed with and without it."""
    pairs = list(zip(on, off, strict=True))

    def agreed(each: list[float]) -> float:
        return float(np.mean(each)) if len({np.sign(value) for value in each}) == 1 else 0.0

    intervals = {
        key: agreed([abs(b.held[key] - int(key.split()[1])) - abs(a.held[key] - int(key.split()[1])) for a, b in pairs])
        for key in on[0].held
        if all(key in each.held for each in (*on, *off))
    }
    which = max(intervals, key=lambda key: intervals[key])
    return Gain(
        rms=agreed([1 - a.rms_m / b.rms_m for a, b in pairs]),
        filled=agreed([a.filled - b.filled for a, b in pairs]),
        interval=intervals[which],
        which=which,
        slower=float(np.median([a.seconds / b.seconds for a, b in pairs])),
    )
