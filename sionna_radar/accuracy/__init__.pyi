from .breakdown import Breakdown as Breakdown
from .breakdown import break_down as break_down
from .checkpoints import CheckpointTest as CheckpointTest
from .checkpoints import checkpoint_test as checkpoint_test
from .classes import ErrorClass as ErrorClass
from .classes import by_class as by_class
from .compare import DemError as DemError
from .compare import difference as difference
from .compare import nmad as nmad
from .compare import summarise as summarise
from .edges import half_footprint_m as half_footprint_m
from .edges import near_walls as near_walls
from .shadow import shadowed as shadowed
from .slope import slope_deg as slope_deg
from .truth import GroundTruth as GroundTruth
from .variogram import Variogram as Variogram
from .variogram import variogram as variogram

__all__ = [
    "Breakdown",
    "CheckpointTest",
    "DemError",
    "ErrorClass",
    "GroundTruth",
    "Variogram",
    "break_down",
    "by_class",
    "checkpoint_test",
    "difference",
    "half_footprint_m",
    "near_walls",
    "nmad",
    "shadowed",
    "slope_deg",
    "summarise",
    "variogram",
]
