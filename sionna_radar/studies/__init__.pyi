from .budget import Budget as Budget
from .budget import run_budget as run_budget
from .crosscheck import CrossCheck as CrossCheck
from .crosscheck import Tolerances as Tolerances
from .crosscheck import fit_material as fit_material
from .design import Axis as Axis
from .design import Design as Design
from .design import Sampler as Sampler
from .design import Span as Span
from .design import parse_design as parse_design
from .design import read_settings as read_settings
from .images import Imagery as Imagery
from .images import run_images as run_images
from .link import LinkBudget as LinkBudget
from .link import run_link_budget as run_link_budget
from .log_inspection import LogInspection as LogInspection
from .log_inspection import inspect_log as inspect_log
from .planning import FlightPlan as FlightPlan
from .planning import Wanted as Wanted
from .planning import check_plan as check_plan
from .planning import plan_flight as plan_flight
from .planning import planned_scenario as planned_scenario
from .range_doppler import Frames as Frames
from .range_doppler import run_frames as run_frames
from .sweep import Case as Case
from .sweep import Sweep as Sweep
from .sweep import Trial as Trial
from .sweep import label as label
from .sweep import plan_sweep as plan_sweep
from .sweep import run_sweep as run_sweep

__all__ = [
    "Axis",
    "Budget",
    "Case",
    "CrossCheck",
    "Design",
    "FlightPlan",
    "Frames",
    "Imagery",
    "LinkBudget",
    "LogInspection",
    "Sampler",
    "Span",
    "Sweep",
    "Tolerances",
    "Trial",
    "Wanted",
    "check_plan",
    "fit_material",
    "inspect_log",
    "label",
    "parse_design",
    "plan_flight",
    "plan_sweep",
    "planned_scenario",
    "read_settings",
    "run_budget",
    "run_frames",
    "run_images",
    "run_link_budget",
    "run_sweep",
]
