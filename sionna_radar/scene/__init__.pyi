from .landscape import Landscape as Landscape
from .landscape import TerrainInputs as TerrainInputs
from .landscape import build_landscape as build_landscape
from .landscape import landscape_of_heights as landscape_of_heights
from .landscape import register_terrain as register_terrain
from .model import Scene as Scene
from .model import Surface as Surface
from .model import Target as Target
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
