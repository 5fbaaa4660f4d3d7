from .effects.atmosphere import build_weather as build_weather, rain_map_of as rain_map_of
from .engine import Engine as Engine, EngineInputs as EngineInputs, build_engine as build_engine, register_engine as register_engine
from .paths import Paths as Paths, TARGET as TARGET, VOLUME as VOLUME
from .tracer import Tracer as Tracer, build_tracer as build_tracer

__all__ = [
    "Engine",
    "EngineInputs",
    "Paths",
    "TARGET",
    "Tracer",
    "VOLUME",
    "build_engine",
    "build_tracer",
    "build_weather",
    "rain_map_of",
    "register_engine",
]
