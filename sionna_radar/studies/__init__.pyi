from .budget import Budget as Budget, navigation_budget as navigation_budget
from .crosscheck_result import CrossCheck as CrossCheck, Tolerances as Tolerances
from .gamma_fit import fit_material as fit_material
from .images import Imagery as Imagery, fly_images as fly_images
from .plan_check import check_plan as check_plan
from .planning import FlightPlan as FlightPlan, Wanted as Wanted, plan_flight as plan_flight, planned_scenario as planned_scenario
from .sweep import Axis as Axis, Case as Case, Sweep as Sweep, Trial as Trial, fly_sweep as fly_sweep, label as label, parse_axes as parse_axes, plan_sweep as plan_sweep

__all__ = [
    "Axis",
    "Budget",
    "Case",
    "CrossCheck",
    "FlightPlan",
    "Imagery",
    "Sweep",
    "Tolerances",
    "Trial",
    "Wanted",
    "check_plan",
    "fit_material",
    "fly_images",
    "fly_sweep",
    "label",
    "navigation_budget",
    "parse_axes",
    "plan_flight",
    "plan_sweep",
    "planned_scenario",
]
