from .mapper import DemMethod as DemMethod, MapInputs as MapInputs, Mapper as Mapper, register_dem_method as register_dem_method
from .points import Points as Points, locate as locate

__all__ = [
    "DemMethod",
    "MapInputs",
    "Mapper",
    "Points",
    "locate",
    "register_dem_method",
]
