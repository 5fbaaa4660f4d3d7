"""The speed that the program promises, as ratios measured side by side in one run."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from time import perf_counter

import numpy as np

from sionna_radar.flight.pulses import Pulses
from sionna_radar.mapping.points import locate
from sionna_radar.scenario import Scenario, load_scenario
from sionna_radar.survey.chain import run
from sionna_radar.survey.preparation import Prepared, prepare
from sionna_radar.tracing.paths import Paths

STOCK_SAMPLES = 1_000_000
RATIOS = 5


@dataclass(frozen=True, kw_only=True)
class Ratio:
    """A measured ratio and the bound it must keep."""

    name: str
    value: float
    bound: float
    at_most: bool

    @property
    def kept(self) -> bool:
        """Whether the bound is kept."""
        return (self.value <= self.bound) == self.at_most

    def __str__(self) -> str:
        word = "at most" if self.at_most else "at least"
        verdict = "ok" if self.kept else "MISSED"
        return f"{self.name:62}{self.value:12,.2f}   {word} {self.bound:,.2f}   {verdict}"


def measure(*, quick: bool = False) -> Iterator[Ratio]:
    """Yield the ratios, RATIOS of them, as they are measured; `quick` takes smaller runs."""
    pulses = 500 if quick else 2000
    yield _effective_path_cost(stock_pulses=2 if quick else 5)
    yield from _against_bare_rays(pulses, repeats=3 if quick else 7)
    yield _faster_than_flight(length_m=300.0 if quick else 900.0)
    yield _memory_growth(1000 if quick else 5000)


def effective_paths(paths: Paths) -> float:
    """Return the mean over pulses of (sum |a|^2)^2 / sum |a|^4: how many equal paths say as much."""
    power = np.abs(paths.gain) ** 2
    pulse = paths.pulse - paths.pulse.min()
    total = np.bincount(pulse, weights=power)
    return float(np.mean(total[total > 0] ** 2 / np.bincount(pulse, weights=power**2)[total > 0]))


def _effective_path_cost(stock_pulses: int) -> Ratio:
    beam = prepare(load_scenario("hills"))
    stock = prepare(load_scenario("hills", {"tracing.engine": "path_solver", "tracing.paths_per_pulse": STOCK_SAMPLES}))
    costs = []
    for prepared, count, repeats in ((stock, stock_pulses, 2), (beam, 1000, 10)):
        engine, pulses = prepared.sensor_inputs().tracer(), prepared.flight.sample(count)
        trace = partial(engine.trace, pulses)
        equal = effective_paths(trace())
        # The least of several times: what the machine does beside it only adds.
        seconds = min(_time(trace) for _ in range(repeats))
        costs.append(seconds / len(pulses) / equal)
    return Ratio(
        name="stock path solver / beam engine, per effective path",
        value=costs[0] / costs[1],
        bound=10_000,
        at_most=False,
    )


def _against_bare_rays(count: int, repeats: int) -> Iterator[Ratio]:
    """Yield tracing and the whole chain over bare Mitsuba ray casting of the same rays."""
    prepared = prepare(load_scenario("hills", {"platform.length_m": 200.0, "platform.start_m": [-140.0, 0.0]}))
    engine = prepared.sensor_inputs().tracer()
    pulses = prepared.flight.pulses(np.arange(min(count, len(prepared))))
    bare = _bare_casting(prepared, engine.trace(pulses), pulses)
    rays, traced, chained = [], [], []
    for _ in range(repeats):
        rays.append(_time(bare))
        traced.append(_time(lambda: engine.trace(pulses)))
        chained.append(_time(lambda: _chain(prepared, engine.trace(pulses), pulses)))
    rays_s = float(np.median(rays))
    yield Ratio(
        name="tracing with fields / bare ray casting",
        value=float(np.median(traced)) / rays_s,
        bound=5,
        at_most=True,
    )
    yield Ratio(
        name="whole chain / bare ray casting",
        value=float(np.median(chained)) / rays_s,
        bound=12,
        at_most=True,
    )


def _chain(prepared: Prepared, paths: Paths, pulses: Pulses) -> None:
    echoes = prepared.detector.detect(prepared.receiver.beat(paths, pulses), pulses.index, pulses.measured)
    locate(echoes, pulses.index, pulses.measured)


def _bare_casting(prepared: Prepared, paths: Paths, pulses: Pulses) -> Callable[[], None]:
    """Return a function that intersects the rays of the paths with the scene and does nothing else."""
    row = paths.pulse - pulses.index[0]
    origin = pulses.true.position_m[row]
    away = paths.hit_m - origin
    rays = prepared.scene.caster.prepare(origin, away / np.linalg.norm(away, axis=1, keepdims=True))
    return lambda: prepared.scene.caster.intersect(rays)


def _faster_than_flight(length_m: float) -> Ratio:
    scenario = load_scenario(
        "hills",
        {
            "terrain.size_m": [length_m + 340.0, 340.0],
            "platform.start_m": [-length_m / 2 - 50.0, 0.0],
            "platform.length_m": length_m,
        },
    )
    survey = run(scenario)
    start, end = survey.schedule.trajectory.cruise_s()
    return Ratio(
        name=f"time flown / time simulated, all stages, {survey.pulses:,} pulses",
        value=(end - start) / survey.timing_s["total"],
        bound=10,
        at_most=False,
    )


def _memory_growth(pulses: int) -> Ratio:
    """Return the peak memory of a survey ten times as long over that of a survey, each in a process of its own."""
    few, many = (_peak_in_process(count) for count in (pulses, 10 * pulses))
    return Ratio(name=f"peak memory, {10 * pulses:,} / {pulses:,} pulses", value=many / few, bound=1.15, at_most=True)


def _peak_in_process(pulses: int) -> float:
    code = (
        "import sys\n"
        "from sionna_radar import run\n"
        "from sionna_radar.studies.bench import memory_scenario\n"
        "print(run(memory_scenario(int(sys.argv[1]))).peak_memory_mb)\n"
    )
    done = subprocess.run([sys.executable, "-c", code, str(pulses)], capture_output=True, text=True, check=True)
    return float(done.stdout)


def memory_scenario(pulses: int) -> Scenario:
    """Return a survey of about that many pulses over the same ground: the more pulses, the slower the flight."""
    sector = 100 / 360
    return load_scenario("hills", {"platform.speed_mps": 100.0 * 360 * sector / pulses})


def _time(action: Callable[[], object]) -> float:
    start = perf_counter()
    action()
    return perf_counter() - start
