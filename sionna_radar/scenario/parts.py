"""The registries of all parts selected by name in a scenario.

To add a built-in part, write its file and add one line here.
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
    {"detection.ranging.estimators": ("peak", "centroid", "leading_edge", "model_fit")},
)
DEM_METHODS = Registry(
    "DEM method",
    {
        "mapping.linear.linear": ("linear",),
        "mapping.refined.refinement": ("smooth", "refined"),
        "mapping.stepped.surface": ("stepped",),
    },
)
SCANS = Registry(
    "scan",
    {"flight.scan": ("whisk_broom", "conical", "fixed", "side_looking", "electronic")},
    ScanParameters,
)
ANTENNAS = Registry(
    "antenna",
    {
        "radar.array_antenna": ("taylor", "array"),
        "radar.pattern_files.reader": ("pattern",),
    },
    AntennaParameters,
)
NAVIGATIONS = Registry(
    "navigation",
    {"flight.navigation": ("errors", "from_log")},
    NavigationParameters,
)
SENSORS = Registry(
    "sensor",
    {
        "survey.sensors.device_radar": ("radar",),
        "survey.sensors.lidar": ("lidar",),
    },
)
ENGINES = Registry(
    "tracing engine",
    {"tracing.engines.ours": ("sionna", "gamma", "path_solver")},
)
TERRAINS = Registry(
    "terrain",
    {
        "scene.terrains.synthetic": ("flat", "hills", "fractal"),
        "scene.terrains.elevation": ("jacksboro", "raster"),
        "scene.terrains.points": ("points",),
        "scene.terrains.mesh": ("mesh",),
        "scene.terrains.city": ("sionna:san_francisco", "sionna:munich", "sionna:florence", "sionna:etoile"),
    },
    TerrainParameters,
)
MATERIALS = Registry(
    "material",
    {
        "surfaces.surface_models": (
            "constant_gamma",
            "lambertian",
            "ulaby_dobson",
            "table",
            "kirchhoff",
            "physical_optics",
            "small_perturbation",
            "integral_equation",
        ),
        "surfaces.sionna_slab": ("sionna_itu",),
    },
    MaterialParameters,
)
RECEIVER_STAGES = Registry(
    "receiver stage",
    {
        "signal.leakage": ("leakage",),
        "signal.mixer": ("mixer",),
        "signal.interference": ("interference",),
        "signal.receiver": ("noise",),
        "signal.filters": ("filters",),
        "signal.converter": ("converter",),
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
        for name, origin in registry.known().items():
            if origin != PACKAGE:
                names.setdefault(origin, []).append(name)
    return names
