"""The studies that are here, found by looking into their folder: none is named outside its own."""

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from pkgutil import iter_modules
from types import ModuleType

from sionna_radar.scenario.registry import PACKAGE

FOLDER = Path(__file__).parents[1] / "studies"


def installed_studies() -> list[str]:
    """Return the names of the studies that are here, with all others that they need."""
    here = {module.name for module in iter_modules([str(FOLDER)]) if module.ispkg}
    return sorted(study for study in here if here.issuperset(getattr(study_module(study), "NEEDS", ())))


def study_module(study: str, submodule: str = "") -> ModuleType | None:
    """Return a study's package, or one module of it, such as "command"; None if it has none."""
    name = ".".join(filter(None, (PACKAGE, "studies", study, submodule)))
    return import_module(name) if find_spec(name) else None
