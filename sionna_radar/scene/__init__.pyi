from .build import World as World
from .build import box_of as box_of
from .landscape import Landscape as Landscape
from .landscape import TerrainInputs as TerrainInputs
from .model import Scene as Scene
from .raycast import RayCaster as RayCaster
from .terrains.build import build_landscape as build_landscape
from .terrains.build import landscape_of_heights as landscape_of_heights
