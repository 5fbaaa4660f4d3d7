"""Airborne millimetre-wave terrain radar, simulated from ray-traced fields to a DEM and its error.

`load_scenario` reads a scenario, `run` flies it, and every stage between can be used alone; see
`sionna_radar.survey.chain` for the chain. Importing this package loads neither NumPy nor Mitsuba.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sionna_radar.scenario import Scenario, load_scenario, parse_scenario
    from sionna_radar.survey.chain import run
    from sionna_radar.survey.result import Survey

    __version__: str

__all__ = ["Scenario", "Survey", "load_scenario", "parse_scenario", "run"]

_HOMES = {
    "Scenario": "sionna_radar.scenario",
    "Survey": "sionna_radar.survey.result",
    "load_scenario": "sionna_radar.scenario",
    "parse_scenario": "sionna_radar.scenario",
    "run": "sionna_radar.survey.chain",
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        # Reading the metadata takes longer than the rest of this import.
        return import_module("importlib.metadata").version("sionna-radar")
    if name not in _HOMES:
        message = f"module {__name__!r} has no attribute {name!r}"
        raise AttributeError(message)
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, "__version__"})
