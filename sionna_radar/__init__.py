"""Airborne millimetre-wave terrain radar, simulated from ray-traced fields to a DEM and its error.

`load_scenario` reads a scenario, `run` flies it, and every stage between can be used alone: each subpackage exports
its own public names, see `sionna_radar.survey` for the chain. Importing this package loads neither NumPy nor Mitsuba.
"""

import sys
from typing import Any

import lazy_loader

_load, _names, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        # Reading the metadata takes longer than the rest of this import.
        from importlib.metadata import version

        return version("sionna-radar")
    return _load(name)


if "IPython" in sys.modules:
    from sionna_radar.notebook import register_with_ipython

    register_with_ipython()


def __dir__() -> list[str]:
    return sorted({*globals(), *_names(), "__version__"})
