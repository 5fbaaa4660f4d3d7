from .build import register_dem_method as register_dem_method
from .mapper import DemMethod as DemMethod
from .mapper import MapInputs as MapInputs
from .mapper import Mapper as Mapper
from .points import Points as Points
from .points import locate as locate
