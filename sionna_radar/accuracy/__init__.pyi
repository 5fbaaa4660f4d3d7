from .breakdown import Breakdown as Breakdown
from .breakdown import ErrorClass as ErrorClass
from .breakdown import Variogram as Variogram
from .breakdown import break_down as break_down
from .breakdown import by_class as by_class
from .breakdown import variogram as variogram
from .checkpoints import CheckpointTest as CheckpointTest
from .checkpoints import checkpoint_test as checkpoint_test
from .checkpoints import slope_deg as slope_deg
from .compare import DemError as DemError
from .compare import difference as difference
from .compare import nmad as nmad
from .compare import summarise as summarise
from .edges import half_footprint_m as half_footprint_m
from .edges import near_walls as near_walls
from .illumination import shadowed as shadowed
from .truth import GroundTruth as GroundTruth

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
