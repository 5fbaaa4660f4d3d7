from .antenna import Antenna as Antenna
from .antenna import Cut as Cut
from .antenna import antenna_of as antenna_of
from .antenna import build_antenna as build_antenna
from .antenna import measured_cut as measured_cut
from .antenna import register_antenna as register_antenna
from .array_antenna import taylor_cut as taylor_cut
from .array_pattern import ArrayPattern as ArrayPattern
from .array_pattern import ElementPattern as ElementPattern
from .array_pattern import array_factor as array_factor
from .array_pattern import steered as steered
from .chirp import Chirp as Chirp
from .chirp import build_chirp as build_chirp
from .chirp import build_sweeps as build_sweeps
from .equation import plane_echo as plane_echo
from .pattern import ProductPattern as ProductPattern
from .pattern import SphericalPattern as SphericalPattern
from .pattern_files.reader import read_pattern as read_pattern

__all__ = [
    "Antenna",
    "ArrayPattern",
    "Chirp",
    "Cut",
    "ElementPattern",
    "ProductPattern",
    "SphericalPattern",
    "antenna_of",
    "array_factor",
    "build_antenna",
    "build_chirp",
    "build_sweeps",
    "measured_cut",
    "plane_echo",
    "read_pattern",
    "register_antenna",
    "steered",
    "taylor_cut",
]
