"""Chirps a second from rays to range profiles, by the CPU and by a GPU where one is usable."""

import os
import subprocess
import sys
from collections.abc import Iterator
from time import perf_counter

import numpy as np

from sionna_radar.raytracer.backend import BACKEND_VARIABLE, gpu_usable
from sionna_radar.scenario import load_scenario
from sionna_radar.studies.ratio import Ratio
from sionna_radar.survey.preparation import prepare

TERRAINS = ("hills", "san_francisco")
SPECKLES = ("persistent", "per_pulse")
REPEATS = 3


def backend_ratios() -> int:
    """Return how many ratios there are on this machine."""
    return len(TERRAINS) * len(SPECKLES) * (2 if gpu_usable() else 1)


def measure_backends(pulses: int) -> Iterator[Ratio]:
    """Yield the chirps a second of the CPU, and of a usable GPU over those, each in a process of its own."""
    for terrain in TERRAINS:
        for speckle in SPECKLES:
            name = f"{terrain}, {speckle.replace('_', ' ')} speckle"
            host = _in_process("llvm", terrain, speckle, pulses)
            yield Ratio(name=f"chirps a second, {name}, CPU", value=host, bound=None, at_most=False)
            if gpu_usable():
                ratio = _in_process("cuda", terrain, speckle, pulses) / host
                yield Ratio(name=f"chirps a second, {name}, GPU / CPU", value=ratio, bound=None, at_most=False)


def chirps_a_second(terrain: str, speckle: str, count: int) -> float:
    """Return how many chirps a second this process traces, receives, transforms and searches for echoes."""
    prepared = prepare(load_scenario(terrain, {"tracing.speckle": speckle}))
    sensor, pulses = prepared.build_sensor(), prepared.flight.pulses(np.arange(min(count, len(prepared))))

    def seconds() -> float:
        start = perf_counter()
        sensor.observe(pulses)
        return perf_counter() - start

    seconds()
    return len(pulses) / min(seconds() for _ in range(REPEATS))


def _in_process(backend: str, terrain: str, speckle: str, count: int) -> float:
    code = f"from {__name__} import chirps_a_second\nprint(chirps_a_second({terrain!r}, {speckle!r}, {count}))\n"
    settings = {**os.environ, BACKEND_VARIABLE: backend}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=settings)
    return float(done.stdout)
