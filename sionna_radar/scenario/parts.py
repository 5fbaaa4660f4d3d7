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
        "peak": "sionna_radar.detection.ranging.peak",
        "centroid": "sionna_radar.detection.ranging.centroid",
        "leading_edge": "sionna_radar.detection.ranging.leading_edge",
        "model_fit": "sionna_radar.detection.ranging.model_fit",
    },
)
DEM_METHODS = Registry(
    "DEM method",
    {
        "linear": "sionna_radar.mapping.methods.linear",
        "smooth": "sionna_radar.mapping.methods.smooth",
        "refined": "sionna_radar.mapping.methods.refined",
        "stepped": "sionna_radar.mapping.methods.stepped",
    },
)
SCANS = Registry(
    "scan",
    {
        "whisk_broom": "sionna_radar.flight.scans.rotating",
        "conical": "sionna_radar.flight.scans.rotating",
        "fixed": "sionna_radar.flight.scans.rotating",
        "side_looking": "sionna_radar.flight.scans.side_looking",
        "electronic": "sionna_radar.flight.scans.electronic",
    },
    ScanParameters,
)
ANTENNAS = Registry(
    "antenna",
    {
        "taylor": "sionna_radar.radar.taylor_array",
        "pattern": "sionna_radar.radar.measured_antenna",
        "array": "sionna_radar.radar.array_antenna",
    },
    AntennaParameters,
)
NAVIGATIONS = Registry(
    "navigation",
    {"errors": "sionna_radar.flight.navigation", "from_log": "sionna_radar.flight.logged_errors"},
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
        "flat": "sionna_radar.scene.terrains.flat",
        "hills": "sionna_radar.scene.terrains.hills",
        "fractal": "sionna_radar.scene.terrains.fractal",
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
        "constant_gamma": "sionna_radar.surfaces.models.empirical",
        "lambertian": "sionna_radar.surfaces.models.empirical",
        "ulaby_dobson": "sionna_radar.surfaces.models.empirical",
        "table": "sionna_radar.surfaces.models.empirical",
        "kirchhoff": "sionna_radar.surfaces.models.rough",
        "physical_optics": "sionna_radar.surfaces.models.rough",
        "small_perturbation": "sionna_radar.surfaces.models.rough",
        "integral_equation": "sionna_radar.surfaces.models.rough",
        "sionna_itu": "sionna_radar.surfaces.models.sionna_slab",
    },
    MaterialParameters,
)
RECEIVER_STAGES = Registry(
    "receiver stage",
    {
        "leakage": "sionna_radar.signal.leakage",
        "mixer": "sionna_radar.signal.mixer",
        "interference": "sionna_radar.signal.interference",
        "noise": "sionna_radar.signal.noise",
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
