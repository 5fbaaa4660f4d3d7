"""The registries of all parts selected by name in a scenario.

To add a built-in part, write its file and add one line here: its builder, its table and its facts, so that a scenario
is validated without loading any part.
"""

from __future__ import annotations

from sionna_radar.scenario.bases import (
    AntennaParameters,
    MaterialParameters,
    NavigationParameters,
    ScanParameters,
    StageParameters,
    TerrainParameters,
)
from sionna_radar.scenario.registry import PACKAGE, BuiltIn, Deferred, Facts, Registry

RANGE_ESTIMATORS = Registry(
    "range estimator",
    {
        "peak": BuiltIn("detection.ranging.estimators.PeakRange"),
        "centroid": BuiltIn("detection.ranging.estimators.CentroidRange"),
        "leading_edge": BuiltIn("detection.ranging.estimators.LeadingEdgeRange"),
        "threshold": BuiltIn("detection.ranging.estimators.ThresholdRange"),
        "tracker": BuiltIn("detection.build.tracker_range", "scenario.processing.TrackerTable"),
        "model_fit": BuiltIn("detection.ranging.estimators.ModelFitRange"),
    },
)
DEM_METHODS = Registry(
    "DEM method",
    {
        "linear": BuiltIn("mapping.linear.linear.Linear", "mapping.options.LinearParameters"),
        "smooth": BuiltIn(
            "mapping.refined.refinement.Smooth", "mapping.options.SmoothParameters", facts=Facts(profiles="optional")
        ),
        "refined": BuiltIn(
            "mapping.refined.refinement.Refined", "mapping.options.SmoothParameters", facts=Facts(profiles="required")
        ),
        "stepped": BuiltIn(
            "mapping.stepped.surface.Stepped", "mapping.options.SteppedParameters", facts=Facts(profiles="required")
        ),
        "canopy": BuiltIn(
            "mapping.canopy.canopy.Canopy", "mapping.options.CanopyParameters", facts=Facts(profiles="required")
        ),
    },
)
SCANS = Registry(
    "scan",
    {
        "whisk_broom": BuiltIn("flight.build.rotating_scan", "scenario.radar.ScanTable"),
        "conical": BuiltIn("flight.build.rotating_scan", "scenario.radar.ScanTable"),
        "fixed": BuiltIn("flight.build.rotating_scan", "scenario.radar.ScanTable"),
        "side_looking": BuiltIn("flight.build.side_looking_scan", "scenario.radar.ScanTable"),
        "electronic": BuiltIn("flight.build.electronic_scan", "scenario.radar.ElectronicScanTable"),
    },
    ScanParameters,
)
ANTENNAS = Registry(
    "antenna",
    {
        "taylor": BuiltIn("radar.build.taylor_array", "scenario.radar.AntennaTable"),
        "array": BuiltIn("radar.build.array_antenna", "scenario.radar.ArrayAntennaTable"),
        "pattern": BuiltIn("radar.build.measured_antenna", "scenario.radar.PatternAntennaTable"),
    },
    AntennaParameters,
)
NAVIGATIONS = Registry(
    "navigation",
    {
        "errors": BuiltIn("flight.build.inertial_errors", "scenario.platform.NavigationTable"),
        "from_log": BuiltIn("flight.build.logged_errors", "scenario.platform.LoggedErrorsTable"),
    },
    NavigationParameters,
)
SENSORS = Registry(
    "sensor",
    {
        "radar": BuiltIn("survey.sensors.device_radar.build_radar", facts=Facts(provides_profiles=True)),
        "lidar": BuiltIn("survey.sensors.lidar.lidar"),
        "mimo": BuiltIn("survey.sensors.mimo.build_mimo"),
        "camera": BuiltIn("survey.sensors.camera.camera"),
    },
)
ENGINES = Registry(
    "tracing engine",
    {
        "sionna": BuiltIn("tracing.build.sionna_engine"),
        "gamma": BuiltIn("tracing.build.gamma_engine"),
        "path_solver": BuiltIn("tracing.build.stock_engine"),
    },
)
_CLOUD = Facts(uses=("window_m",), frame=Deferred("scene.terrains.build.cloud_frame"))
_RASTER = Facts(uses=("window_m",), frame=Deferred("scene.terrains.build.raster_frame"))
_CITY = BuiltIn("scene.terrains.build.city", "scenario.terrain.CityTerrain", Facts(uses=("carrier_hz", "channel")))
TERRAINS = Registry(
    "terrain",
    {
        "flat": BuiltIn("scene.terrains.build.flat", "scenario.terrain.FlatTerrain", Facts(uses=())),
        "hills": BuiltIn("scene.terrains.build.hills", "scenario.terrain.HillsTerrain", Facts(uses=())),
        "fractal": BuiltIn("scene.terrains.build.fractal", "scenario.terrain.FractalTerrain", Facts(uses=())),
        "jacksboro": BuiltIn("scene.terrains.build.sample_or_raster", "scenario.terrain.SampleTerrain", _RASTER),
        "raster": BuiltIn("scene.terrains.build.sample_or_raster", "scenario.terrain.RasterTerrain", _RASTER),
        "points": BuiltIn("scene.terrains.build.cloud", "scenario.terrain.PointsTerrain", _CLOUD),
        "mesh": BuiltIn(
            "scene.terrains.build.mesh_ground",
            "scenario.terrain.MeshTerrain",
            Facts(uses=(), frame=Deferred("scene.terrains.build.mesh_frame")),
        ),
        "sionna:san_francisco": _CITY,
        "sionna:munich": _CITY,
        "sionna:florence": _CITY,
        "sionna:etoile": _CITY,
    },
    TerrainParameters,
)
MATERIALS = Registry(
    "material",
    {
        "constant_gamma": BuiltIn("surfaces.build.constant_gamma", "scenario.materials.ConstantGamma"),
        "lambertian": BuiltIn("surfaces.build.lambertian", "scenario.materials.Lambertian"),
        "ulaby_dobson": BuiltIn("surfaces.build.ulaby_dobson", "scenario.materials.UlabyDobson"),
        "table": BuiltIn("surfaces.build.measured", "scenario.materials.MeasuredTable"),
        "kirchhoff": BuiltIn("surfaces.build.kirchhoff", "scenario.materials.Kirchhoff"),
        "physical_optics": BuiltIn("surfaces.build.physical_optics", "scenario.materials.PhysicalOptics"),
        "small_perturbation": BuiltIn("surfaces.build.small_perturbation", "scenario.materials.SmallPerturbation"),
        "integral_equation": BuiltIn("surfaces.build.integral_equation", "scenario.materials.IntegralEquation"),
        "sionna_itu": BuiltIn("surfaces.build.sionna_itu", "scenario.materials.SionnaItu"),
    },
    MaterialParameters,
)
RECEIVER_STAGES = Registry(
    "receiver stage",
    {
        "leakage": BuiltIn("signal.build.build_leakage", "scenario.bases.StageParameters"),
        "mixer": BuiltIn("signal.build.build_mixer", "scenario.bases.StageParameters"),
        "interference": BuiltIn("signal.build.build_interference_stage", "scenario.bases.StageParameters"),
        "noise": BuiltIn("signal.build.build_noise_stage", "scenario.bases.StageParameters"),
        "filters": BuiltIn("signal.build.build_filters", "scenario.bases.StageParameters"),
        "converter": BuiltIn("signal.build.build_converter", "scenario.bases.StageParameters"),
    },
    StageParameters,
)
ALL = (
    DEM_METHODS,
    RANGE_ESTIMATORS,
    MATERIALS,
    SCANS,
    ANTENNAS,
    NAVIGATIONS,
    SENSORS,
    ENGINES,
    TERRAINS,
    RECEIVER_STAGES,
)


def custom_parts() -> dict[str, list[str]]:
    """Return the names of all custom parts by origin."""
    names: dict[str, list[str]] = {}
    for registry in ALL:
        for name, origin in registry.origins().items():
            if origin != PACKAGE:
                names.setdefault(origin, []).append(name)
    return names
