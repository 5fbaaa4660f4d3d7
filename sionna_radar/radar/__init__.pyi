from .antenna import Antenna as Antenna
from .antenna import Cut as Cut
from .antenna import build_antenna as build_antenna
from .antenna import measured_cut as measured_cut
from .antenna import register_antenna as register_antenna
from .chirp import Chirp as Chirp
from .chirp import build_chirp as build_chirp
from .chirp import build_sweeps as build_sweeps
from .equation import plane_echo as plane_echo
from .taylor_array import taylor_cut as taylor_cut

__all__ = [
    "Antenna",
    "Chirp",
    "Cut",
    "build_antenna",
    "build_chirp",
    "build_sweeps",
    "measured_cut",
    "plane_echo",
    "register_antenna",
    "taylor_cut",
]
