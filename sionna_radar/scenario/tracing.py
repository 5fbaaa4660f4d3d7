"""Table `[tracing]`: the ray-tracing engine, speckle, and the number of paths."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from sionna_radar.scenario.choice import NameIn, ParametersOf
from sionna_radar.scenario.parts import ENGINES
from sionna_radar.scenario.table import Conflicts, Real, Table

MAX_PATHS_PER_PULSE = 100_000
PATHS_OF_QUALITY = {"fast": 256, "normal": 512, "fine": 1024}


class TracingTable(Table):
    """Tracing of the scene into paths: engine, speckle, number of rays."""

    engine: Annotated[str, NameIn(ENGINES)] = "sionna"
    """Tracing engine: "sionna" (Sionna RT's fields inside the beam), "gamma" (the paper's facet model, independent of
    Sionna), "path_solver" (Sionna's stock solver, slow, for checks), or a custom one."""
    engine_parameters: Annotated[Table | None, ParametersOf("engine", ENGINES)] = None
    """Parameters of a custom engine."""
    speckle: Literal["per_pulse", "persistent"] = "persistent"
    """Speckle from pulse to pulse. "persistent" keeps scatterers on the surface, so that phase and speckle from chirp
    to chirp are those of a real scene; "per_pulse" draws new ones each pulse, as over a surface that moves between
    chirps. Default: persistent where the engine supports it; "path_solver" draws new paths each pulse."""
    scatterers_per_m2: Annotated[Real | None, Field(gt=0, le=10_000)] = None
    """Density of persistent scatterers of the engine "sionna". Default: set by the beam's footprint, so that a pulse
    sees some `paths_per_pulse`, and ten in a range cell."""
    decorrelation_time_s: Annotated[Real | None, Field(gt=0, le=1e9)] = None
    """Time after which the correlation of the echo's field with itself has fallen to 1/e, over a surface that moves
    like grass in the wind; it needs persistent speckle. Default: the surface stands still."""
    bounces: Annotated[int, Field(strict=True, ge=1, le=2)] = 1
    """Highest number of reflections. 2 lets the wave meet a second surface on its way, if one of both, or both, is a
    plane that reflects as a mirror (`materials.NAME.specular`): the ground before a wall, a corner. Engine "sionna"
    only."""
    quality: Literal["fast", "normal", "fine"] = "normal"
    """Number of rays inside the beam of a pulse, or of scatterers: 256, 512 or 1,024. Fewer understate range errors, by
    3 % ("fast") and 1.5 % ("normal") against "fine"; mean power and its spread do not depend on it. Unused where
    `paths_per_pulse` is given."""
    paths_per_pulse: Annotated[int | None, Field(strict=True, ge=16, le=10**7)] = None
    """Number of rays inside the beam of a pulse, or of scatterers. Default: that of `quality`."""
    side_lobe_share: Annotated[Real, Field(ge=0.01, le=0.5)] = 0.05
    """Fraction of the rays that sample the side lobes."""

    @property
    def paths(self) -> int:
        """Number of rays inside the beam of a pulse, or of scatterers: as given, or by the quality."""
        return self.paths_per_pulse or PATHS_OF_QUALITY[self.quality]

    @model_validator(mode="before")
    @classmethod
    def _speckle_of_the_solver(cls, table: Any) -> Any:
        if isinstance(table, Mapping) and table.get("engine") == "path_solver" and "speckle" not in table:
            return {**table, "speckle": "per_pulse"}
        return table

    def _conflicts(self) -> Conflicts:
        if self.decorrelation_time_s is not None and self.speckle == "per_pulse":
            message = "has no effect with speckle = 'per_pulse', which redraws every pulse; remove one"
            yield "decorrelation_time_s", message
        if self.engine == "path_solver" and self.speckle == "persistent":
            yield "speckle", "path_solver draws new paths each pulse; set engine = 'sionna' or 'gamma'"
        if self.bounces == 2 and self.engine != "sionna":
            yield "bounces", f"engine = {self.engine!r} supports single bounces only; set engine = 'sionna'"
        if self.engine == "sionna" and self.paths > MAX_PATHS_PER_PULSE:
            yield (
                "paths_per_pulse",
                f"{self.paths:,} of a block of pulses do not fit into memory; give at most "
                f"{MAX_PATHS_PER_PULSE:,} (the rays of engine = 'path_solver', most of which miss, may be more)",
            )
