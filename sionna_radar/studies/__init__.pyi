from .budget import Budget as Budget
from .budget import navigation_budget as navigation_budget
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
from .images import fly_images as fly_images
from .link import LinkBudget as LinkBudget
from .link import link_budget as link_budget
from .log_inspection import LogInspection as LogInspection
from .log_inspection import inspect_log as inspect_log
from .planning import FlightPlan as FlightPlan
from .planning import Wanted as Wanted
from .planning import check_plan as check_plan
from .planning import plan_flight as plan_flight
from .planning import planned_scenario as planned_scenario
from .range_doppler import Frames as Frames
from .range_doppler import fly_frames as fly_frames
from .sweep import Case as Case
from .sweep import Sweep as Sweep
from .sweep import Trial as Trial
from .sweep import fly_sweep as fly_sweep
from .sweep import label as label
from .sweep import plan_sweep as plan_sweep

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
    "fly_frames",
    "fly_images",
    "fly_sweep",
    "inspect_log",
    "label",
    "link_budget",
    "navigation_budget",
    "parse_design",
    "plan_flight",
    "plan_sweep",
    "planned_scenario",
    "read_settings",
]
