from .bases import AntennaParameters as AntennaParameters
from .bases import CoveredTerrain as CoveredTerrain
from .bases import MaterialParameters as MaterialParameters
from .bases import NavigationParameters as NavigationParameters
from .bases import ScanParameters as ScanParameters
from .bases import StageParameters as StageParameters
from .bases import TerrainParameters as TerrainParameters
from .lidar import LidarTable as LidarTable
from .loading import load_scenario as load_scenario
from .loading import parse_overrides as parse_overrides
from .loading import parse_scenario as parse_scenario
from .loading import shipped_scenarios as shipped_scenarios
from .loading import to_toml as to_toml
from .materials import ConstantGamma as ConstantGamma
from .materials import IntegralEquation as IntegralEquation
from .materials import Kirchhoff as Kirchhoff
from .materials import Lambertian as Lambertian
from .materials import MeasuredTable as MeasuredTable
from .materials import PhysicalOptics as PhysicalOptics
from .materials import SionnaItu as SionnaItu
from .materials import SmallPerturbation as SmallPerturbation
from .materials import UlabyDobson as UlabyDobson
from .objects import Building as Building
from .objects import Footprints as Footprints
from .objects import MeshObject as MeshObject
from .objects import PointTarget as PointTarget
from .objects import TargetMesh as TargetMesh
from .platform import NavigationTable as NavigationTable
from .platform import Platform as Platform
from .processing import CfarTable as CfarTable
from .processing import DemTable as DemTable
from .processing import ProcessingTable as ProcessingTable
from .radar import AntennaTable as AntennaTable
from .radar import ArrayAntennaTable as ArrayAntennaTable
from .radar import ElectronicScanTable as ElectronicScanTable
from .radar import PatternAntennaTable as PatternAntennaTable
from .radar import RadarTable as RadarTable
from .radar import ScanTable as ScanTable
from .receiver import OscillatorTable as OscillatorTable
from .receiver import ReceiverTable as ReceiverTable
from .reference import reference as reference
from .reference import scenario_schema as scenario_schema
from .scenario import Scenario as Scenario
from .table import NonNegative as NonNegative
from .table import Parameters as Parameters
from .table import Positive as Positive
from .table import Real as Real
from .terrain import CityTerrain as CityTerrain
from .terrain import FlatTerrain as FlatTerrain
from .terrain import FractalTerrain as FractalTerrain
from .terrain import HillsTerrain as HillsTerrain
from .terrain import MeshTerrain as MeshTerrain
from .terrain import RasterTerrain as RasterTerrain
from .terrain import SampleTerrain as SampleTerrain
from .tracing import TracingTable as TracingTable
from .weather import WeatherTable as WeatherTable

__all__ = [
    "AntennaParameters",
    "AntennaTable",
    "ArrayAntennaTable",
    "Building",
    "CfarTable",
    "CityTerrain",
    "ConstantGamma",
    "CoveredTerrain",
    "DemTable",
    "ElectronicScanTable",
    "FlatTerrain",
    "Footprints",
    "FractalTerrain",
    "HillsTerrain",
    "IntegralEquation",
    "Kirchhoff",
    "Lambertian",
    "LidarTable",
    "MaterialParameters",
    "MeasuredTable",
    "MeshObject",
    "MeshTerrain",
    "NavigationParameters",
    "NavigationTable",
    "NonNegative",
    "OscillatorTable",
    "Parameters",
    "PatternAntennaTable",
    "PhysicalOptics",
    "Platform",
    "PointTarget",
    "Positive",
    "ProcessingTable",
    "RadarTable",
    "RasterTerrain",
    "Real",
    "ReceiverTable",
    "SampleTerrain",
    "ScanParameters",
    "ScanTable",
    "Scenario",
    "SionnaItu",
    "SmallPerturbation",
    "StageParameters",
    "TargetMesh",
    "TerrainParameters",
    "TracingTable",
    "UlabyDobson",
    "WeatherTable",
    "load_scenario",
    "parse_overrides",
    "parse_scenario",
    "reference",
    "scenario_schema",
    "shipped_scenarios",
    "to_toml",
]
