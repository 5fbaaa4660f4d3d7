"""The engine that traces the paths, and how many: `[tracing]`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from sionna_radar.scenario.choice import ParametersOf, name_in
from sionna_radar.scenario.parts import ENGINES
from sionna_radar.scenario.table import Real, Table, refuse

MOST_PATHS_PER_PULSE = 100_000


class TracingTable(Table):
    """How the scene is turned into paths.

    engine: sionna (Sionna RT's fields inside the beam), gamma (the paper's facet model, independent of Sionna), or
        path_solver (Sionna's stock solver, slow, for checks); or a custom one.
    engine_parameters: of a custom engine that has some.
    speckle: per_pulse draws new phases each pulse; persistent keeps scatterers on the surface, so that phase from
        chirp to chirp is that of a real scene.
    scatterers_per_m2: density of persistent scatterers.
    paths_per_pulse: rays inside the beam of a pulse.
    side_lobe_share: share of the rays that look for side lobes over the lower hemisphere.
    """

    engine: Annotated[str, name_in(ENGINES)] = "sionna"
    engine_parameters: Annotated[Table | None, ParametersOf("engine", ENGINES)] = None
    speckle: Literal["per_pulse", "persistent"] = "per_pulse"
    scatterers_per_m2: Annotated[Real, Field(gt=0, le=10_000)] = 20.0
    paths_per_pulse: Annotated[int, Field(strict=True, ge=16, le=10**7)] = 512
    side_lobe_share: Annotated[Real, Field(ge=0.01, le=0.5)] = 0.05

    @model_validator(mode="after")
    def _speckle_of_the_engine(self) -> TracingTable:
        if self.engine == "path_solver" and self.speckle == "persistent":
            raise refuse("speckle", "path_solver draws new paths each pulse; set engine = 'sionna' or 'gamma'")
        if self.engine == "sionna" and self.paths_per_pulse > MOST_PATHS_PER_PULSE:
            raise refuse(
                "paths_per_pulse",
                f"{self.paths_per_pulse:,} of a block of pulses do not fit into memory; give at most "
                f"{MOST_PATHS_PER_PULSE:,} (the rays of engine = 'path_solver', most of which miss, may be more)",
            )
        return self
