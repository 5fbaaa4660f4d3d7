from .detection import register_range_estimator as register_range_estimator
from .execution import Execution as Execution
from .execution import open_workers as open_workers
from .flight import register_navigation as register_navigation
from .flight import register_scan as register_scan
from .foundation import RadarError as RadarError
from .foundation import Raster as Raster
from .foundation import ScenarioError as ScenarioError
from .mapping import Points as Points
from .mapping import register_dem_method as register_dem_method
from .radar import register_antenna as register_antenna
from .report import write_survey as write_survey
from .scenario import Parameters as Parameters
from .scenario import Scenario as Scenario
from .scenario import load_scenario as load_scenario
from .scenario import parse_scenario as parse_scenario
from .scenario import shipped_scenarios as shipped_scenarios
from .scenario import to_toml as to_toml
from .scene import register_terrain as register_terrain
from .signal import register_receiver_stage as register_receiver_stage
from .studies.budget import Budget as Budget
from .studies.budget import run_budget as run_budget
from .studies.crosscheck import CrossCheck as CrossCheck
from .studies.crosscheck import run_crosscheck as run_crosscheck
from .studies.images import Imagery as Imagery
from .studies.images import run_images as run_images
from .studies.sweep import Sweep as Sweep
from .studies.sweep import plan_sweep as plan_sweep
from .studies.sweep import run_sweep as run_sweep
from .surfaces import register_material as register_material
from .survey import CustomParts as CustomParts
from .survey import Prepared as Prepared
from .survey import Processed as Processed
from .survey import Survey as Survey
from .survey import prepare as prepare
from .survey import process as process
from .survey import register_sensor as register_sensor
from .survey import run as run
from .tracing import register_engine as register_engine

__version__: str

__all__ = [
    "Budget",
    "CrossCheck",
    "CustomParts",
    "Execution",
    "Imagery",
    "Parameters",
    "Points",
    "Prepared",
    "Processed",
    "RadarError",
    "Raster",
    "Scenario",
    "ScenarioError",
    "Survey",
    "Sweep",
    "load_scenario",
    "open_workers",
    "parse_scenario",
    "plan_sweep",
    "prepare",
    "process",
    "register_antenna",
    "register_dem_method",
    "register_engine",
    "register_material",
    "register_navigation",
    "register_range_estimator",
    "register_receiver_stage",
    "register_scan",
    "register_sensor",
    "register_terrain",
    "run",
    "run_budget",
    "run_crosscheck",
    "run_images",
    "run_sweep",
    "shipped_scenarios",
    "to_toml",
    "write_survey",
]
