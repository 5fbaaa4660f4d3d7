"""The speed that the program promises, as ratios measured side by side in one run: `pytest -m benchmark -n 0`.

The table of `docs/checks/speed.md` gets a column for the version that was measured, or a new one in its place.
"""

import csv
import os
import subprocess
import sys
from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import sionna_radar
from benchmark_cases import (
    HERE,
    Ratio,
    bare_casting,
    measure_backends,
    measure_channels,
    measure_engines,
    measure_growth,
    measure_reuse,
    measure_start,
    seconds_of,
    side_by_side,
)
from sionna_radar.flight.pulses import Pulses
from sionna_radar.mapping.points import locate
from sionna_radar.scenario import Scenario, load_scenario
from sionna_radar.studies.live.frame import Frame
from sionna_radar.studies.live.radar import Radar
from sionna_radar.survey.chain import run
from sionna_radar.survey.preparation import Prepared, prepare
from sionna_radar.survey.result import Survey
from sionna_radar.tracing.paths import Paths
from sionna_radar.tracing.tracer import SteeredTracer, Tracer

STOCK_SAMPLES = 1_000_000
LOOP_HZ = 20.0
SPEED = Path(__file__).parents[2] / "docs" / "checks" / "speed.csv"
# Terrain, settings, and how many times faster than the flight the whole chain must at least be.
METHODS: tuple[tuple[str, dict[str, object], float], ...] = (
    ("hills", {"dem.method": "smooth"}, 10.0),
    ("hills", {"dem.method": "refined"}, 5.0),
    ("hills", {"dem.method": "refined", "radar.antenna.beamwidth_deg": 8.0}, 5.0),
    ("buildings", {"dem.method": "stepped"}, 2.0),
    ("san_francisco", {"dem.method": "stepped"}, 1.0),
)
BEAMS_DEG = (1.0, 2.0, 4.0, 8.0)


def measure() -> Iterator[Ratio]:
    """Yield the ratios as they are measured."""
    yield _effective_path_cost(stock_pulses=5)
    yield from _against_bare_rays(2000, repeats=7)
    yield from measure_engines(2000)
    yield from measure_channels(2)
    yield from _persistent_over_per_pulse(512, repeats=7)
    yield from _faster_than_flight(length_m=900.0)
    yield from _methods()
    yield from _steps_in_a_loop(300)
    yield from measure_reuse(20, 100.0)
    yield from measure_start()
    yield from measure_backends(1024)
    yield _linear_in_length(200.0, 2000.0)
    yield _memory_growth(5000)


def told(ratios: Iterable[Ratio], capsys: pytest.CaptureFixture[str]) -> list[Ratio]:
    """Print ratios as they come, and return them."""
    found = []
    with capsys.disabled():
        print()
        for ratio in ratios:
            print(ratio, flush=True)
            found.append(ratio)
    return found


def missed(ratios: Iterable[Ratio]) -> list[str]:
    """Return what is told of ratios that miss their bounds."""
    return [str(ratio) for ratio in ratios if not ratio.kept]


def record(ratios: Iterable[Ratio], table: Path, version: str) -> None:
    """Write ratios into a table with a column for each version; those of other versions stay."""
    rows: list[dict[str, str]] = []
    if table.exists():
        with table.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    by_name = {row["ratio"]: row for row in rows}
    for ratio in ratios:
        by_name.setdefault(ratio.name, {"ratio": ratio.name})[version] = f"{ratio.value:,.3g}"
    versions = dict.fromkeys(name for row in by_name.values() for name in row if name != "ratio")
    with table.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, ["ratio", *versions], restval="", lineterminator="\n")
        writer.writeheader()
        writer.writerows(by_name.values())


@pytest.mark.benchmark
@pytest.mark.usefixtures("unchecked")
def test_every_ratio_keeps_its_bound(capsys):
    ratios = told(measure(), capsys)
    record(ratios, SPEED, sionna_radar.__version__)
    assert missed(ratios) == []


def test_a_table_of_speed_gains_a_column_for_each_version(tmp_path):
    table = tmp_path / "speed.csv"
    old, new = (Ratio(name="trace / rays", value=value, bound=2, at_most=True) for value in (1.5, 1.4))
    record([old], table, "0.1.0")
    record([old], table, "0.2.0")
    record([new, Ratio(name="study / maps", value=1.1, bound=None, at_most=True)], table, "0.2.0")
    assert table.read_text() == "ratio,0.1.0,0.2.0\ntrace / rays,1.5,1.4\nstudy / maps,,1.1\n"


@pytest.mark.study
def test_surveys_grow_in_proportion_to_facets_and_pulses(capsys):
    """Up to 10,000,000 facets and 200,000 pulses; minutes."""
    assert missed(told(measure_growth(), capsys)) == []


def effective_paths(paths: Paths) -> float:
    """Return the mean over pulses of (sum |a|^2)^2 / sum |a|^4: how many equal paths say as much."""
    power = np.abs(paths.gain) ** 2
    pulse = paths.pulse - paths.pulse.min()
    total = np.bincount(pulse, weights=power)
    return float(np.mean(total[total > 0] ** 2 / np.bincount(pulse, weights=power**2)[total > 0]))


def _effective_path_cost(stock_pulses: int) -> Ratio:
    beam = prepare(load_scenario("hills", {"tracing.speckle": "per_pulse"}))
    stock = prepare(load_scenario("hills", {"tracing.engine": "path_solver", "tracing.paths_per_pulse": STOCK_SAMPLES}))
    costs = []
    for prepared, count, repeats in ((stock, stock_pulses, 2), (beam, 1000, 10)):
        engine, pulses = prepared.sensor_inputs().tracer(), prepared.flight.sample(count)
        trace = partial(engine.trace, pulses)
        equal = effective_paths(trace())
        # The least of several times: what the machine does beside it only adds.
        seconds = min(seconds_of(trace) for _ in range(repeats))
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
    actions = (
        bare_casting(prepared, engine.trace(pulses), pulses),
        lambda: engine.trace(pulses),
        lambda: _chain(prepared, engine.trace(pulses), pulses),
    )
    rays_s, traced_s, chained_s = np.median(side_by_side(actions, repeats), axis=0)
    # The same code has 1.5 on one machine and 2.0 on another.
    yield Ratio(name="tracing with fields / bare ray casting", value=float(traced_s / rays_s), bound=2.2, at_most=True)
    yield Ratio(name="whole chain / bare ray casting", value=float(chained_s / rays_s), bound=4, at_most=True)


def _steps_in_a_loop(steps: int) -> Iterator[Ratio]:
    """Yield how much of the 50 ms between the poses of a loop a step takes, and that over bare ray casting."""
    for beams, median, most in ((64, 0.4, 0.9), (1, 0.18, None)):
        down = {"radar.scan.mode": "fixed", "radar.scan.incidence_deg": 0.0, "radar.chirp_rate_hz": beams * LOOP_HZ}
        radar = Radar(load_scenario("hills", down))
        radar.warm_up()

        def step(number: int, radar: Radar = radar) -> Frame:
            place_m = (-100.0 + 0.1 * number, 0.0, 60.0)
            return radar.step(number / LOOP_HZ, place_m, (0.0, 0.0, np.pi / 2), (2.0, 0.0, 0.0))

        frame = [step(number) for number in range(20)][-1]
        assert frame.observation is not None
        bare = bare_casting(radar.prepared, frame.observation.paths, frame.pulses)
        seconds = [(seconds_of(bare), seconds_of(partial(step, number))) for number in range(20, 20 + steps)]
        bare_s, step_s = np.array(seconds).T
        name = f"step of {beams} beam{'s' * (beams > 1)}"
        bare_ratio = float(np.median(step_s) / np.median(bare_s))
        yield Ratio(name=f"{name} / bare ray casting", value=bare_ratio, bound=None, at_most=True)
        share = float(np.median(step_s)) * LOOP_HZ
        yield Ratio(name=f"{name}, of 50 ms", value=share, bound=median, at_most=True)
        if most is not None:
            share = float(np.quantile(step_s, 0.95)) * LOOP_HZ
            yield Ratio(name=f"{name}, 95 % of them, of 50 ms", value=share, bound=most, at_most=True)


def _chain(prepared: Prepared, paths: Paths, pulses: Pulses) -> None:
    echoes = prepared.instrument.detector.detect(prepared.receiver.beat(paths, pulses), pulses.index, pulses.measured)
    locate(echoes, pulses.index, pulses.measured)


def _persistent_over_per_pulse(count: int, repeats: int) -> Iterator[Ratio]:
    """Yield what speckle that stays on the surface costs, tracing to echoes, over speckle drawn anew."""
    for beam_deg in BEAMS_DEG:
        flights = []
        for speckle in ("per_pulse", "persistent"):
            scenario = load_scenario("hills", {"radar.antenna.beamwidth_deg": beam_deg, "tracing.speckle": speckle})
            prepared = prepare(scenario)
            pulses = prepared.flight.pulses(np.arange(count))
            flights.append(partial(_trace_and_detect, prepared, prepared.sensor_inputs().tracer(), pulses))
        times = side_by_side(flights, repeats).min(axis=0)
        yield Ratio(
            name=f"speckle that stays / drawn anew, trace to echoes, {beam_deg:g} deg",
            value=float(times[1] / times[0]),
            bound=1.5,
            at_most=True,
        )


def _trace_and_detect(prepared: Prepared, tracer: Tracer | SteeredTracer, pulses: Pulses) -> None:
    _chain(prepared, tracer.trace(pulses), pulses)


def _faster_than_flight(length_m: float) -> Iterator[Ratio]:
    """Yield how much faster than the flight surveys are, one of 1,000 pulses also in a new process."""
    short = load_scenario("hills")
    for name, value in (
        ("in a new process", _flown_s(run(short)) / _seconds_in_process()),
        ("again", _times_faster(short)),
    ):
        yield Ratio(name=f"time flown / time simulated, hills, {name}", value=value, bound=None, at_most=False)
    scenario = over_hills(length_m)
    yield Ratio(
        name=f"time flown / time simulated, all stages, {len(prepare(scenario)):,} pulses",
        value=_times_faster(scenario),
        bound=40,
        at_most=False,
    )


def _methods() -> Iterator[Ratio]:
    for terrain, settings, bound in METHODS:
        settings_told = ", ".join(f"{key.rpartition('.')[2]} {value}" for key, value in settings.items())
        yield Ratio(
            name=f"time flown / time simulated, {terrain}, {settings_told}",
            value=_times_faster(load_scenario(terrain, settings)),
            bound=bound,
            at_most=False,
        )


def _linear_in_length(short_m: float, long_m: float) -> Ratio:
    """Return the time a pulse of a long survey takes, after preparation, over that of a short one."""
    surveys = [
        min((run(over_hills(length)) for _ in range(2)), key=_after_preparation_s) for length in (short_m, long_m)
    ]
    each = [_after_preparation_s(survey) / survey.pulses for survey in surveys]
    return Ratio(name=f"time a pulse, {long_m:g} m / {short_m:g} m", value=each[1] / each[0], bound=1.15, at_most=True)


def _after_preparation_s(survey: Survey) -> float:
    return survey.timing_s["total"] - survey.timing_s["prepare"]


def _times_faster(scenario: Scenario) -> float:
    """Return the time flown over the least of two simulations; the first loads and compiles what is needed."""
    surveys = [run(scenario) for _ in range(2)]
    return _flown_s(surveys[0]) / min(survey.timing_s["total"] for survey in surveys)


def _flown_s(survey: Survey) -> float:
    start, end = survey.schedule.trajectory.cruise_s()
    return end - start


def over_hills(length_m: float) -> Scenario:
    """Return `hills` with a longer terrain under a longer flight."""
    return load_scenario(
        "hills",
        {
            "terrain.size_m": [length_m + 340.0, 340.0],
            "platform.start_m": [-length_m / 2 - 50.0, 0.0],
            "platform.length_m": length_m,
        },
    )


def _memory_growth(pulses: int) -> Ratio:
    """Return the peak memory of a survey ten times as long over that of a survey, each in a process of its own."""
    few, many = (_peak_in_process(count) for count in (pulses, 10 * pulses))
    return Ratio(name=f"peak memory, {10 * pulses:,} / {pulses:,} pulses", value=many / few, bound=1.15, at_most=True)


def _peak_in_process(pulses: int) -> float:
    return float(_said(f"from benchmark_cases import long_survey\nprint(run(long_survey({pulses})).peak_memory_mb)\n"))


def _seconds_in_process() -> float:
    """Return how long `hills` takes in a process that has yet to load everything."""
    return seconds_of(lambda: _said("run(load_scenario('hills'))"))


def _said(code: str) -> str:
    command = [sys.executable, "-c", "from sionna_radar import load_scenario, run\n" + code]
    return subprocess.run(command, capture_output=True, text=True, check=True, env={**os.environ, **HERE}).stdout
