"""The same scenario and seed give the same bits, however many cores and BLAS threads the machine has."""

import os
import subprocess
import sys

import pytest

from sionna_radar import load_scenario, run
from sionna_radar.execution.execution import Execution
from sionna_radar.foundation.threads import THREADS_VARIABLE

TWO_CORES = pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="a single core")
FLOWN = """
import hashlib, os, sys
if sys.argv[1] == "one":
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
from sionna_radar import load_scenario, run

def tell(name, changes):
    survey = run(load_scenario(name, changes))
    print(survey.points.sha256(), hashlib.sha256(survey.dem.height_m.tobytes()).hexdigest())

city = {"terrain.kind": "sionna:etoile", "platform.length_m": 1.0, "platform.start_m": [0.0, 0.0]}
tell("san_francisco", city)
small = {"platform.length_m": 2.5, "platform.start_m": [-60.0, 0.0], "dem.spacing_m": 2.0}
tell("buildings", small | {"dem.method": "refined"})
tell("buildings", small | {"tracing.speckle": "per_pulse"})
few = {"platform.length_m": 0.3, "tracing.engine": "path_solver", "tracing.paths_per_pulse": 20000}
tell("buildings", small | few | {"radar.antenna.beamwidth_deg": 20.0})
"""


def flown(cores: str, threads: str) -> list[str]:
    settings = {name: value for name, value in os.environ.items() if name != "SIONNA_RADAR_THREADS"}
    settings |= {"OMP_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": threads}
    command = [sys.executable, "-c", FLOWN, cores]
    done = subprocess.run(command, capture_output=True, text=True, env=settings, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="this system binds no process to a core")
@TWO_CORES
def test_cores_and_threads_change_nothing():
    many = flown("all", "2")
    assert len(many) == 8
    assert flown("one", "1") == many


@TWO_CORES
@pytest.mark.parametrize(
    ("scene", "changes"),
    [
        ("hills", {"dem.method": "stepped"}),
        ("hills", {"dem.method": "refined", "tracing.speckle": "per_pulse"}),
        ("rain", {"dem.method": "linear"}),
    ],
)
def test_threads_of_one_process_change_nothing(scene, changes, monkeypatch):
    """Loops of kernels, and the scatterers of the next block, which are looked for ahead where there are two."""
    small = {"platform.length_m": 6.0, "terrain.spacing_m": 2.0, "tracing.paths_per_pulse": 64}
    found = []
    for threads in ("1", "2"):
        monkeypatch.setenv(THREADS_VARIABLE, threads)
        survey = run(load_scenario(scene, small | changes), execution=Execution(block_size=60))
        found.append((survey.points.sha256(), survey.dem.height_m.tobytes(), survey.dem_sigma.height_m.tobytes()))
    assert found[0] == found[1]
