"""The same scenario and seed give the same bits, however many cores and BLAS threads the machine has."""

import contextlib
import io
import os
import subprocess
import sys

import pytest
from threadpoolctl import threadpool_limits

from sionna_radar import load_scenario, run
from sionna_radar.execution.execution import Execution
from sionna_radar.foundation.threads import THREADS_VARIABLE

TWO_CORES = pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="a single core")
FLOWN = """
import hashlib
from sionna_radar import load_scenario, run

def tell(name, changes):
    survey = run(load_scenario(name, changes))
    print(survey.points.sha256(), hashlib.sha256(survey.dem.height_m.tobytes()).hexdigest())

city = {"terrain.kind": "sionna:etoile", "platform.length_m": 1.0, "platform.start_m": [0.0, 0.0]}
tell("san_francisco", city)
small = {"platform.length_m": 2.5, "platform.start_m": [-60.0, 0.0], "dem.spacing_m": 2.0}
tell("buildings", small | {"dem.method": "refined"})
tell("buildings", small | {"tracing.speckle": "per_pulse"})
few = {"platform.length_m": 0.15, "tracing.engine": "path_solver", "tracing.paths_per_pulse": 3000}
tell("buildings", small | few | {"radar.antenna.beamwidth_deg": 20.0})
"""
ON_ONE_CORE = "import os; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})" + FLOWN


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="this system binds no process to a core")
@TWO_CORES
def test_cores_and_threads_change_nothing(monkeypatch):
    """All cores and two BLAS threads in this process, one of each in another."""
    monkeypatch.delenv(THREADS_VARIABLE, raising=False)
    many = io.StringIO()
    with contextlib.redirect_stdout(many), threadpool_limits(2):
        exec(FLOWN, {})
    single = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    one = subprocess.run([sys.executable, "-c", ON_ONE_CORE], capture_output=True, text=True, env=single, check=False)
    assert one.returncode == 0, one.stderr
    assert len(one.stdout.split()) == 8
    assert one.stdout == many.getvalue()


@TWO_CORES
@pytest.mark.usefixtures("sketched_rain")
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
