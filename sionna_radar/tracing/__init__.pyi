from .effects.atmosphere import build_weather as build_weather
from .effects.atmosphere import rain_map_of as rain_map_of
from .effects.bodies import rcs_of_mesh as rcs_of_mesh
from .engine import Engine as Engine
from .engine import EngineInputs as EngineInputs
from .engine import build_engine as build_engine
from .engine import register_engine as register_engine
from .paths import BOUNCED as BOUNCED
from .paths import TARGET as TARGET
from .paths import VOLUME as VOLUME
from .paths import Paths as Paths
from .tracer import Tracer as Tracer
from .tracer import build_tracer as build_tracer

__all__ = [
    "BOUNCED",
    "TARGET",
    "VOLUME",
    "Engine",
    "EngineInputs",
    "Paths",
    "Tracer",
    "build_engine",
    "build_tracer",
    "build_weather",
    "rain_map_of",
    "rcs_of_mesh",
    "register_engine",
]
