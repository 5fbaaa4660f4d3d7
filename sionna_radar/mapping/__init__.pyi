from .mapper import DemMethod as DemMethod
from .mapper import MapInputs as MapInputs
from .points import locate as locate
