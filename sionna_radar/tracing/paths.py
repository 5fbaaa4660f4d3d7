"""The table of propagation paths that every engine returns."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Complex, Float, Int

# What stands in `Paths.surface` where no surface is hit.
TARGET = -1
VOLUME = -2


@dataclass(frozen=True, kw_only=True)
class Paths:
    """Monostatic single-bounce paths, one row each, sorted by pulse.

    pulse: running number of the pulse in the survey.
    delay_s: two-way delay at the middle of the chirp.
    gain: received over sent wave; |gain|^2 is a ratio of powers, the phase leaves out the delay.
    range_rate_mps: positive when receding.
    incidence_rad: angle between the ray and the surface normal; NaN for a point target and for the air.
    hit_m: where the surface is hit, world frame; of what fills the air, its place on the boresight.
    surface: index of the surface in the scene; TARGET (-1) for a point target, VOLUME (-2) for a cell of
        what fills the air: rain, snow, fog, dust.
    """

    pulse: Int[np.ndarray, " path"]
    delay_s: Float[np.ndarray, " path"]
    gain: Complex[np.ndarray, " path"]
    range_rate_mps: Float[np.ndarray, " path"]
    incidence_rad: Float[np.ndarray, " path"]
    hit_m: Float[np.ndarray, "path 3"]
    surface: Int[np.ndarray, " path"]

    def __len__(self) -> int:
        return len(self.pulse)

    def only(self, chosen: Bool[np.ndarray, " path"]) -> "Paths":
        """Return some of the rows."""
        return Paths(**{f.name: getattr(self, f.name)[chosen] for f in fields(self)})

    @staticmethod
    def concatenate(tables: Sequence["Paths"]) -> "Paths":
        """Return all rows of some tables, sorted by pulse, equal pulses in the order given."""
        columns = {f.name: np.concatenate([getattr(t, f.name) for t in tables]) for f in fields(Paths)}
        order = np.argsort(columns["pulse"], kind="stable")
        return Paths(**{name: column[order] for name, column in columns.items()})
