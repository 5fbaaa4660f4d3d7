from .landscape import Landscape as Landscape, TerrainInputs as TerrainInputs, build_landscape as build_landscape, landscape_of_heights as landscape_of_heights, register_terrain as register_terrain
from .model import Scene as Scene, Surface as Surface, Target as Target
from .raycast import RayCaster as RayCaster

__all__ = [
    "Landscape",
    "RayCaster",
    "Scene",
    "Surface",
    "Target",
    "TerrainInputs",
    "build_landscape",
    "landscape_of_heights",
    "register_terrain",
]
