from .detection import register_range_estimator as register_range_estimator
from .flight import register_navigation as register_navigation, register_scan as register_scan
from .foundation import RadarError as RadarError, Raster as Raster, ScenarioError as ScenarioError
from .mapping import Points as Points, register_dem_method as register_dem_method
from .radar import register_antenna as register_antenna
from .report import write_survey as write_survey
from .scenario import Parameters as Parameters, Scenario as Scenario, load_scenario as load_scenario, parse_scenario as parse_scenario, shipped_scenarios as shipped_scenarios, to_toml as to_toml
from .scene import register_terrain as register_terrain
from .studies.budget import Budget as Budget, navigation_budget as navigation_budget
from .studies.crosscheck import crosscheck as crosscheck
from .studies.crosscheck_result import CrossCheck as CrossCheck
from .studies.images import Imagery as Imagery, fly_images as fly_images
from .studies.sweep import Sweep as Sweep, fly_sweep as fly_sweep, plan_sweep as plan_sweep
from .surfaces import register_material as register_material
from .survey import CustomParts as CustomParts, Prepared as Prepared, Survey as Survey, prepare as prepare, register_sensor as register_sensor, run as run
from .tracing import register_engine as register_engine

__version__: str

__all__ = [
    "Budget",
    "CrossCheck",
    "CustomParts",
    "Imagery",
    "Parameters",
    "Points",
    "Prepared",
    "RadarError",
    "Raster",
    "Scenario",
    "ScenarioError",
    "Survey",
    "Sweep",
    "crosscheck",
    "fly_images",
    "fly_sweep",
    "load_scenario",
    "navigation_budget",
    "parse_scenario",
    "plan_sweep",
    "prepare",
    "register_antenna",
    "register_dem_method",
    "register_engine",
    "register_material",
    "register_navigation",
    "register_range_estimator",
    "register_scan",
    "register_sensor",
    "register_terrain",
    "run",
    "shipped_scenarios",
    "to_toml",
    "write_survey",
]
