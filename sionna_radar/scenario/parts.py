"""The registries of all parts that a scenario chooses by name.

To add a part of ours, write its file and add one line here.
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
from sionna_radar.scenario.registry import PACKAGE, Registry

RANGE_ESTIMATORS = Registry(
    "range estimator",
    {
        "peak": "sionna_radar.detection.ranging.estimators",
        "centroid": "sionna_radar.detection.ranging.estimators",
        "leading_edge": "sionna_radar.detection.ranging.estimators",
        "model_fit": "sionna_radar.detection.ranging.estimators",
    },
)
DEM_METHODS = Registry(
    "DEM method",
    {
        "linear": "sionna_radar.mapping.linear.linear",
        "smooth": "sionna_radar.mapping.refined.refinement",
        "refined": "sionna_radar.mapping.refined.refinement",
        "stepped": "sionna_radar.mapping.stepped.surface",
    },
)
SCANS = Registry(
    "scan",
    {
        "whisk_broom": "sionna_radar.flight.scan",
        "conical": "sionna_radar.flight.scan",
        "fixed": "sionna_radar.flight.scan",
        "side_looking": "sionna_radar.flight.scan",
        "electronic": "sionna_radar.flight.scan",
    },
    ScanParameters,
)
ANTENNAS = Registry(
    "antenna",
    {
        "taylor": "sionna_radar.radar.array_antenna",
        "pattern": "sionna_radar.radar.pattern_files.reader",
        "array": "sionna_radar.radar.array_antenna",
    },
    AntennaParameters,
)
NAVIGATIONS = Registry(
    "navigation",
    {"errors": "sionna_radar.flight.navigation", "from_log": "sionna_radar.flight.navigation"},
    NavigationParameters,
)
SENSORS = Registry(
    "sensor",
    {"radar": "sionna_radar.survey.sensors.device_radar", "lidar": "sionna_radar.survey.sensors.lidar"},
)
ENGINES = Registry(
    "tracing engine",
    {
        "sionna": "sionna_radar.tracing.engines.ours",
        "gamma": "sionna_radar.tracing.engines.ours",
        "path_solver": "sionna_radar.tracing.engines.ours",
    },
)
TERRAINS = Registry(
    "terrain",
    {
        "flat": "sionna_radar.scene.terrains.synthetic",
        "hills": "sionna_radar.scene.terrains.synthetic",
        "fractal": "sionna_radar.scene.terrains.synthetic",
        "jacksboro": "sionna_radar.scene.terrains.elevation",
        "raster": "sionna_radar.scene.terrains.elevation",
        "points": "sionna_radar.scene.terrains.points",
        "mesh": "sionna_radar.scene.terrains.mesh",
        "sionna:san_francisco": "sionna_radar.scene.terrains.city",
        "sionna:munich": "sionna_radar.scene.terrains.city",
        "sionna:florence": "sionna_radar.scene.terrains.city",
        "sionna:etoile": "sionna_radar.scene.terrains.city",
    },
    TerrainParameters,
)
MATERIALS = Registry(
    "material",
    {
        "constant_gamma": "sionna_radar.surfaces.surface_models",
        "lambertian": "sionna_radar.surfaces.surface_models",
        "ulaby_dobson": "sionna_radar.surfaces.surface_models",
        "table": "sionna_radar.surfaces.surface_models",
        "kirchhoff": "sionna_radar.surfaces.surface_models",
        "physical_optics": "sionna_radar.surfaces.surface_models",
        "small_perturbation": "sionna_radar.surfaces.surface_models",
        "integral_equation": "sionna_radar.surfaces.surface_models",
        "sionna_itu": "sionna_radar.surfaces.sionna_slab",
    },
    MaterialParameters,
)
RECEIVER_STAGES = Registry(
    "receiver stage",
    {
        "leakage": "sionna_radar.signal.leakage",
        "mixer": "sionna_radar.signal.mixer",
        "interference": "sionna_radar.signal.interference",
        "noise": "sionna_radar.signal.receiver",
        "filters": "sionna_radar.signal.filters",
        "converter": "sionna_radar.signal.converter",
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
    """Return the names of all parts that are not this package's own, by where they come from."""
    found: dict[str, list[str]] = {}
    for registry in ALL:
        for name, origin in registry.known().items():
            if origin != PACKAGE:
                found.setdefault(origin, []).append(name)
    return found
