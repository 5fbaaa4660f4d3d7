from .compare import DemError as DemError
from .compare import difference as difference
from .compare import summarise as summarise
from .edges import half_footprint_m as half_footprint_m
from .edges import near_walls as near_walls
from .shadow import shadowed as shadowed
from .truth import GroundTruth as GroundTruth

__all__ = [
    "DemError",
    "GroundTruth",
    "difference",
    "half_footprint_m",
    "near_walls",
    "shadowed",
    "summarise",
]
