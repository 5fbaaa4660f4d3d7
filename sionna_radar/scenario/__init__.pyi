from .bases import AntennaParameters as AntennaParameters, CoveredTerrain as CoveredTerrain, MaterialParameters as MaterialParameters, NavigationParameters as NavigationParameters, ScanParameters as ScanParameters, TerrainParameters as TerrainParameters
from .dem import DemTable as DemTable
from .lidar import LidarTable as LidarTable
from .loading import load_scenario as load_scenario, parse_overrides as parse_overrides, parse_scenario as parse_scenario, shipped_scenarios as shipped_scenarios, to_toml as to_toml
from .materials import ConstantGamma as ConstantGamma, IntegralEquation as IntegralEquation, Kirchhoff as Kirchhoff, Lambertian as Lambertian, MeasuredTable as MeasuredTable, PhysicalOptics as PhysicalOptics, SionnaItu as SionnaItu, SmallPerturbation as SmallPerturbation, UlabyDobson as UlabyDobson
from .navigation import NavigationTable as NavigationTable
from .objects import Building as Building, PointTarget as PointTarget
from .platform import Platform as Platform
from .processing import CfarTable as CfarTable, ProcessingTable as ProcessingTable
from .radar import AntennaTable as AntennaTable, RadarTable as RadarTable, ReceiverTable as ReceiverTable, ScanTable as ScanTable
from .scenario import Scenario as Scenario
from .table import Parameters as Parameters
from .terrain import CityTerrain as CityTerrain, FlatTerrain as FlatTerrain, FractalTerrain as FractalTerrain, HillsTerrain as HillsTerrain, RasterTerrain as RasterTerrain, SampleTerrain as SampleTerrain
from .tracing import TracingTable as TracingTable
from .weather import WeatherTable as WeatherTable

__all__ = [
    "AntennaParameters",
    "AntennaTable",
    "Building",
    "CfarTable",
    "CityTerrain",
    "ConstantGamma",
    "CoveredTerrain",
    "DemTable",
    "FlatTerrain",
    "FractalTerrain",
    "HillsTerrain",
    "IntegralEquation",
    "Kirchhoff",
    "Lambertian",
    "LidarTable",
    "MaterialParameters",
    "MeasuredTable",
    "NavigationParameters",
    "NavigationTable",
    "Parameters",
    "PhysicalOptics",
    "Platform",
    "PointTarget",
    "ProcessingTable",
    "RadarTable",
    "RasterTerrain",
    "ReceiverTable",
    "SampleTerrain",
    "ScanParameters",
    "ScanTable",
    "Scenario",
    "SionnaItu",
    "SmallPerturbation",
    "TerrainParameters",
    "TracingTable",
    "UlabyDobson",
    "WeatherTable",
    "load_scenario",
    "parse_overrides",
    "parse_scenario",
    "shipped_scenarios",
    "to_toml",
]
