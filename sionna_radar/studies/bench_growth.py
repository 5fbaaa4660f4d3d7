"""How a survey grows: with the facets of its terrain, and with its pulses; each measured in a process of its own."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from sionna_radar.foundation.memory import peak_memory_mb
from sionna_radar.foundation.workers import document_of
from sionna_radar.mapping.points import locate
from sionna_radar.scenario import Scenario, load_scenario
from sionna_radar.studies.ratio import Ratio
from sionna_radar.survey.chain import run
from sionna_radar.survey.preparation import prepare

FACETS = (10_000, 100_000, 1_000_000, 10_000_000)
PULSES = (1_000, 200_000)
TERRAIN_M = 320.0
# Pulses by which all that a survey keeps for its whole length has been allocated.
SETTLED_SHARE = 0.1
GROWTH_RATIOS = len(FACETS) + 4


def measure_growth() -> Iterator[Ratio]:
    """Yield the ratios, GROWTH_RATIOS of them, as they are measured; minutes in all."""
    yield from _facets()
    yield from _pulses()


def _facets() -> Iterator[Ratio]:
    """Yield time per pulse and memory over terrains of more and more facets, over the same ground."""
    least = _in_process("over_facets", FACETS[0])
    for count in FACETS[1:]:
        found = _in_process("over_facets", count)
        name = f"{found['facets']:,} / {least['facets']:,} facets, trace to echoes"
        yield Ratio(name=f"time a pulse, {name}", value=found["pulse_s"] / least["pulse_s"], bound=2.5, at_most=True)
    each = 1e6 * (found["peak_mb"] - least["peak_mb"]) / (found["facets"] - least["facets"])
    yield Ratio(name="memory a facet, bytes", value=each, bound=None, at_most=True)


def _pulses() -> Iterator[Ratio]:
    """Yield how time and memory of a survey grow with its pulses, and what a long one leaves behind."""
    few, many = (_in_process("over_pulses", count) for count in PULSES)
    name = f"{many['pulses']:,} / {few['pulses']:,} pulses"
    each = [found["flown_s"] / found["pulses"] for found in (few, many)]
    yield Ratio(name=f"time a pulse, {name}", value=each[1] / each[0], bound=1.1, at_most=True)
    yield Ratio(name=f"peak memory, {name}", value=many["peak_mb"] / few["peak_mb"], bound=1.1, at_most=True)
    growth, at = many["settled_mb"][1] / many["settled_mb"][0], f"{SETTLED_SHARE:.0%} of {many['pulses']:,} pulses"
    yield Ratio(name=f"memory at the end / at {at}", value=growth, bound=1.1, at_most=True)
    left = float(many["handles"] + many["temporary_files"])
    yield Ratio(name="open handles and temporary files more at the end", value=left, bound=0.0, at_most=True)


def over_facets(count: int) -> dict[str, Any]:
    """Return what some pulses take over `hills` of so many facets: seconds each, and the memory of this process."""
    spacing_m = TERRAIN_M / np.sqrt(count / 2)
    prepared = prepare(load_scenario("hills", {"terrain.spacing_m": float(f"{spacing_m:.6g}")}))
    pulses = prepared.flight.pulses(np.arange(500))
    tracer = prepared.sensor_inputs().tracer()

    def chain() -> float:
        start = perf_counter()
        beat = prepared.receiver.beat(tracer.trace(pulses), pulses)
        echoes = prepared.detector.detect(beat, pulses.index, pulses.measured)
        locate(echoes, pulses.index, pulses.measured)
        return perf_counter() - start

    seconds = min(chain() for _ in range(6))
    facets = sum(len(surface.faces) for surface in prepared.scene.scene.surfaces)
    return {"facets": facets, "pulse_s": seconds / len(pulses), "peak_mb": peak_memory_mb()}


def over_pulses(count: int) -> dict[str, Any]:
    """Return what a survey of so many pulses takes after preparation, and what it leaves open."""
    run(long_survey(PULSES[0]))
    resident: list[tuple[float, float]] = []

    def progress(stage: str, done: int, total: int) -> None:
        if stage == "tracing" and total:
            resident.append((done / total, _resident_mb()))

    handles, files = _handles(), _temporary_files()
    survey = run(long_survey(count), progress=progress)
    settled = [mb for share, mb in resident if share >= SETTLED_SHARE]
    return {
        "pulses": survey.pulses,
        "flown_s": survey.timing_s["total"] - survey.timing_s["prepare"],
        "peak_mb": peak_memory_mb(),
        "settled_mb": [settled[0], settled[-1]],
        "handles": _handles() - handles,
        "temporary_files": _temporary_files() - files,
    }


def long_survey(pulses: int) -> Scenario:
    """Return a survey of about that many pulses over the same ground: the more pulses, the slower the flight."""
    sector = 100 / 360
    return load_scenario("hills", {"platform.speed_mps": 100.0 * 360 * sector / pulses})


def _resident_mb() -> float:
    with Path("/proc/self/statm").open() as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def _handles() -> int:
    return sum(1 for _ in Path("/proc/self/fd").iterdir())


def _temporary_files() -> int:
    return sum(1 for _ in Path(tempfile.gettempdir()).iterdir())


def _in_process(function: str, count: int) -> dict[str, Any]:
    says = "from sionna_radar.foundation.workers import document_bytes\nprint(document_bytes"
    heaps = "from sionna_radar.foundation.memory import tune_heaps\ntune_heaps()"
    code = f"{heaps}\nfrom {__name__} import {function}\n{says}({function}({count})).decode())\n"
    # A place of its own for temporary files, so that only what it leaves there is counted.
    with tempfile.TemporaryDirectory() as own:
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True, env={**os.environ, "TMPDIR": own}
        )
    found: dict[str, Any] = document_of(done.stdout.encode())
    return found
