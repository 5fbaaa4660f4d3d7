"""A sweep that several files of tests look at."""

import pytest

from sionna_radar.execution.execution import Execution
from sionna_radar.studies.sweep.plan import plan_sweep
from sionna_radar.studies.sweep.settings import parse_design
from sionna_radar.studies.sweep.study import run_sweep


@pytest.fixture(scope="module")
def flown(small, rough_errors):
    """Return the plan, the sweep and the progress of two beams with two range estimators, two seeds each."""
    axes = parse_design(["radar.antenna.beamwidth_deg=2,6", "processing.ranging=peak,centroid"])
    calls = []
    plan = plan_sweep(small, axes, repeat=2)
    sweep = run_sweep(plan, execution=Execution(progress=lambda *step: calls.append(step)))
    assert [case.reason for case in sweep.cases if case.reason] == []
    return plan, sweep, calls
