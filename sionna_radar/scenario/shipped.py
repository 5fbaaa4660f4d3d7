"""The shipped scenarios, by name; without the tables that they are read with."""

from functools import cache
from pathlib import Path

from sionna_radar.foundation.errors import InputFileError


@cache
def scenes_directory() -> Path:
    """Return the folder of shipped scenarios: inside the wheel, or beside the package in a checkout.

    Raises InputFileError where the installation lacks it.
    """
    package = Path(__file__).resolve().parents[1]
    for candidate in (package / "scenes", package.parent / "scenes"):
        if candidate.is_dir():
            return candidate
    raise InputFileError(f"the shipped scenarios are missing beside {package}; install the package again")


def shipped_scenarios() -> dict[str, Path]:
    """Return the files of the shipped scenarios by name.

    Returns
    -------
    Paths of TOML files by name of the scenario.

    Examples
    --------
    >>> "hills" in shipped_scenarios()
    True
    """
    return {path.stem: path for path in sorted(scenes_directory().glob("*.toml"))}
