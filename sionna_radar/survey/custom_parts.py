"""Custom parts given from Python in place of parts of a scenario: antenna, method, sensor, terrain and others."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Shaped

from sionna_radar.detection.ranging.estimators import RangeEstimator
from sionna_radar.flight.pulses import MeasuredPoseFlight, Navigation
from sionna_radar.flight.scan import Scan
from sionna_radar.foundation.errors import PluginError, ScenarioError
from sionna_radar.foundation.raster import Raster
from sionna_radar.mapping.mapper import DemMethod
from sionna_radar.radar.antenna import Antenna
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.bases import CoveredTerrain
from sionna_radar.scenario.registry import require
from sionna_radar.scenario.terrain import RasterTerrain
from sionna_radar.scene.landscape import Landscape, TerrainInputs
from sionna_radar.surfaces.backscatter import Backscatter
from sionna_radar.survey.sensors.sensor import Sensor, SensorInputs
from sionna_radar.tracing.build import EngineInputs
from sionna_radar.tracing.paths import Engine

TerrainSource = (
    Callable[[TerrainInputs], Landscape] | Raster | tuple[Shaped[np.ndarray, "row column"], float] | str | Path
)


def checked_terrain(ground: Any) -> Callable[[TerrainInputs], Landscape] | Raster | str | Path | None:
    """Return given ground, an array with its spacing as a raster; refuse what is none, with the remedy."""
    if isinstance(ground, tuple):
        try:
            height_m, spacing_m = ground
            return Raster.from_array(height_m, spacing_m)
        except (TypeError, ValueError) as error:
            message = f"{error}; a tuple is (heights, spacing_m): an array, rows from south to north, and metres"
            raise ScenarioError.of("terrain", message) from None
    if ground is None or callable(ground) or isinstance(ground, Raster | str | Path):
        return ground
    raise PluginError(
        f"terrain is of the type {type(ground).__name__}; give (heights, spacing_m) with heights as a NumPy array "
        "(row, column), a Raster, the path of an elevation file, or a function that builds it"
    )


def over_file(scenario: Scenario, path: str | Path) -> Scenario:
    """Return a scenario over an elevation file, with the material and the covers of its own terrain."""
    terrain_keys = scenario.terrain.model_dump(exclude_unset=True)
    kept = RasterTerrain.model_fields if isinstance(scenario.terrain, RasterTerrain) else CoveredTerrain.model_fields
    terrain = {name: value for name, value in terrain_keys.items() if name in kept} | {"kind": "raster", "path": path}
    return scenario.replace({"terrain": terrain})


@dataclass(frozen=True, kw_only=True)
class CustomParts:
    """Objects in place of parts of a scenario; None keeps the scenario's.

    See `sionna_radar.run` for each. Raises PluginError for a part that lacks a method.

    Examples
    --------
    >>> import numpy as np
    >>> from sionna_radar.radar import Antenna, taylor_cut
    >>> cut = taylor_cut(float(np.deg2rad(3.0)), -25.0)
    >>> custom = CustomParts(antenna=Antenna(cut, cut))
    >>> prepared = prepare(load_scenario("hills", {"platform.length_m": 10.0}), custom)
    >>> run(prepared).replaced
    {'radar.antenna': 'sionna_radar.radar.antenna.Antenna, half-power beam 3 x 3 deg'}
    """

    antenna: Antenna | None = None
    flight: MeasuredPoseFlight | None = None
    scan: Scan | None = None
    navigation: Navigation | None = None
    terrain: TerrainSource | None = None
    materials: Mapping[str, Backscatter] = field(default_factory=dict)
    engine: Callable[[EngineInputs], Engine] | None = None
    sensor: Callable[[SensorInputs], Sensor] | None = None
    range_estimator: RangeEstimator | None = None
    dem_method: DemMethod | None = None

    def __post_init__(self) -> None:
        kinds = {
            "antenna": Antenna,
            "scan": Scan,
            "navigation": Navigation,
            "range_estimator": RangeEstimator,
            "dem_method": DemMethod,
        }
        for name, kind in kinds.items():
            if getattr(self, name) is not None:
                require(getattr(self, name), kind, name)
        object.__setattr__(self, "terrain", checked_terrain(self.terrain))
        for name in ("engine", "sensor"):
            if getattr(self, name) is not None and not callable(getattr(self, name)):
                raise PluginError(f"{name} is {getattr(self, name)!r}; give what builds it, a class or a function")

    def described(self) -> dict[str, str]:
        """Return descriptions of the custom parts, by the keys of the scenario that they replace."""
        parts = {
            "radar.antenna": self.antenna,
            "platform": self.flight,
            "radar.scan": self.scan,
            "platform.navigation": self.navigation,
            "terrain": self.terrain,
            **{f"materials.{name}": model for name, model in self.materials.items()},
            "tracing.engine": self.engine,
            "sensor": self.sensor,
            "processing.ranging": self.range_estimator,
            "dem.method": self.dem_method,
        }
        words = {key: _name(part) for key, part in parts.items() if part is not None}
        if self.antenna is not None:
            azimuth, elevation = np.rad2deg(self.antenna.beamwidths_rad)
            words["radar.antenna"] += f", half-power beam {azimuth:.3g} x {elevation:.3g} deg"
        return words


def _name(made: object) -> str:
    """Return the module and name of a class or function; of anything else, those of its class."""
    name = getattr(made, "__qualname__", None)
    return f"{made.__module__}.{name}" if name else _name(type(made))


def refuse_for_workers(replaced: Mapping[str, str]) -> None:
    """Raise PluginError for parts that were given in Python, by the keys that they replace."""
    if replaced:
        raise PluginError(
            f"{', '.join(replaced)} replaced from Python: not available on workers; run without workers, or register "
            "it in a package with the entry point sionna_radar.plugins that is installed on them"
        )
