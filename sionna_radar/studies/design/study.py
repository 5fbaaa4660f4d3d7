"""Searching for a radar design: flights, and the statement of the best one."""

from sionna_radar.execution.execution import Execution
from sionna_radar.foundation.progress import stage
from sionna_radar.studies.design.plan import DesignPlan, RadarDesign
from sionna_radar.studies.design.search import Search
from sionna_radar.studies.design.statement import statement_of


def run_design(plan: DesignPlan, *, execution: Execution | None = None) -> RadarDesign:
    """Search for the best design, check it with several seeds, and return it with its standing.

    Parameters
    ----------
    plan:
        From `plan_design`.
    execution:
        As for `sionna_radar.run`; each survey is a task.

    Returns
    -------
    The best design, whether it meets its requirements, and the other designs that were checked.

    Raises
    ------
    ScenarioError
        No setting could be flown.
    BackendError, WorkerError
        As for `run_sweep`.

    Examples
    --------
    >>> from sionna_radar.studies.design import plan_design
    >>> short = {"platform.length_m": 6.0, "terrain.spacing_m": 2.0, "tracing.paths_per_pulse": 32}
    >>> beam = ["radar.antenna.beamwidth_deg=2:6"]
    >>> asked = {"minimise": ["aperture_m"], "require": ["rms_m < 1"], "surveys": 12, "repeat": 2}
    >>> run_design(plan_design("hills", beam, overrides=short, **asked)).holds
    True
    """
    execution = execution or Execution()
    search = Search(plan, execution)
    with execution.reported(), stage("surveys", plan.surveys):
        search.explore()
        search.check()
    return statement_of(search)
