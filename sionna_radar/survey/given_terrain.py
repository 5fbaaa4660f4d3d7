"""Ground that a caller gives in place of a scenario's: heights as they are, a file, or what builds it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Shaped

from sionna_radar.foundation.errors import PluginError, Problem, ScenarioError
from sionna_radar.foundation.raster import Raster
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.bases import CoveredTerrain
from sionna_radar.scenario.terrain import RasterTerrain
from sionna_radar.scene.landscape import Landscape, TerrainInputs

GivenTerrain = (
    Callable[[TerrainInputs], Landscape] | Raster | tuple[Shaped[np.ndarray, "row column"], float] | str | Path
)


def checked_terrain(given: Any) -> Callable[[TerrainInputs], Landscape] | Raster | str | Path | None:
    """Return given ground, an array with its spacing as a raster; refuse what is none, with the remedy."""
    if isinstance(given, tuple):
        try:
            height_m, spacing_m = given
            return Raster.from_array(height_m, spacing_m)
        except (TypeError, ValueError) as error:
            message = f"{error}; a tuple is (heights, spacing_m): an array, rows from south to north, and metres"
            raise ScenarioError([Problem("terrain", message)]) from None
    if given is None or callable(given) or isinstance(given, Raster | str | Path):
        return given
    message = (
        f"terrain is of the type {type(given).__name__}; give (heights, spacing_m) with heights as a NumPy array "
        "(row, column), a Raster, the path of an elevation file, or a function that builds it"
    )
    raise PluginError(message)


def over_file(scenario: Scenario, path: str | Path) -> Scenario:
    """Return a scenario over an elevation file, with the material and the covers of its own terrain."""
    own = scenario.terrain.model_dump(exclude_unset=True)
    kept = RasterTerrain.model_fields if isinstance(scenario.terrain, RasterTerrain) else CoveredTerrain.model_fields
    terrain = {name: value for name, value in own.items() if name in kept} | {"kind": "raster", "path": path}
    return scenario.replace({"terrain": terrain})
