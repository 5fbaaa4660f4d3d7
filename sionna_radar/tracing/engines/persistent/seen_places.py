"""Table of surface places inside the beams of pulses, before tests of visibility and computation of fields."""

from dataclasses import dataclass, fields
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Complex, Float, Int, Shaped
from scipy.constants import speed_of_light

from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.compiled import compiled
from sionna_radar.foundation.threads import over_rows
from sionna_radar.raytracer.backend import VECTOR_BYTES, aligned_room
from sionna_radar.tracing.paths import Paths


@dataclass(frozen=True, kw_only=True)
class SeenPlaces:
    """Places that the pulses of a block see, one column entry each.

    row: of the pulse in its block.
    hit_m: east, north and up.
    solid_angle_sr: that the place represents.
    surface, face: of the scene, and of the surface.
    factor: of the field.
    """

    row: Shaped[np.ndarray, " place"]
    hit_m: Float[np.ndarray, "3 place"]
    range_m: Float[np.ndarray, " place"]
    range_rate_mps: Float[np.ndarray, " place"]
    cosine: Float[np.ndarray, " place"]
    solid_angle_sr: Float[np.ndarray, " place"]
    surface: Int[np.ndarray, " place"]
    face: Int[np.ndarray, " place"]
    factor: Complex[np.ndarray, " place"]

    def __len__(self) -> int:
        return len(self.row)

    @staticmethod
    def room_for(count: int) -> "SeenPlaces":
        """Return a table to be written into, of at least so many entries.

        Its columns share one array, so large that only what is written of it takes memory, and each begins as Dr.Jit
        should get it.
        """
        count = (count // VECTOR_BYTES + 1) * VECTOR_BYTES
        types = {f.name: np.float32 for f in fields(SeenPlaces)} | {
            "row": np.uint32,
            "range_m": np.float64,
            "surface": np.int32,
            "face": np.int32,
            "factor": np.complex64,
        }
        shape = dict.fromkeys(types, (count,)) | {"hit_m": (3, count)}
        columns = np.dtype([(name, types[name], shape[name]) for name in types])
        table = aligned_room(columns.itemsize, np.uint8).view(columns).reshape(())
        return SeenPlaces(**{name: table[name] for name in types})

    def first(self, count: int) -> "SeenPlaces":
        """Return the first entries, in the memory of this table."""
        return SeenPlaces(**{f.name: getattr(self, f.name)[..., :count] for f in fields(self)})

    def keep(self, entries: Int[np.ndarray, " kept"]) -> None:
        """Move some of the entries, in increasing order, to the front."""
        for name in (f.name for f in fields(self)):
            column = getattr(self, name)
            column[..., : len(entries)] = np.take(column, entries, axis=-1)

    def continued(self, count: int, other: "SeenPlaces") -> "SeenPlaces":
        """Write another table behind the first entries of this one, and return both."""
        end = count + len(other)
        for name in (f.name for f in fields(self)):
            getattr(self, name)[..., count:end] = getattr(other, name)
        return self.first(end)

    def only(self, kept: Bool[np.ndarray, " place"] | Int[np.ndarray, " some"]) -> "SeenPlaces":
        """Return some of the entries."""
        return SeenPlaces(**{f.name: getattr(self, f.name)[..., kept] for f in fields(self)})

    @property
    def columns(self) -> tuple[np.ndarray, ...]:
        """All columns, for compiled code; the axes of `hit_m` one by one, so that each column is contiguous."""
        row, hit_m, *others = (getattr(self, f.name) for f in fields(self))
        return row, *hit_m, *others

    def paths(
        self,
        pulses: Pulses,
        field: Complex[np.ndarray, " place"],
        parts: tuple[Int[np.ndarray, " edge"], Int[np.ndarray, " edge"]],
    ) -> Paths:
        """Return the paths to the places, sorted by pulse.

        pulses: the block.
        field: what returns for a factor of one.
        parts: two parts of the table, of which a pulse's paths are those of the first and then those of the second:
            where those of each pulse begin.
        """
        begin = sum(edges - edges[0] for edges in parts)
        count, single = int(begin[-1]), np.float32
        out = Paths(
            pulse=np.empty(count, dtype=np.int64),
            delay_s=np.empty(count),
            gain=np.empty(count, dtype=np.complex64),
            range_rate_mps=np.empty(count, dtype=single),
            incidence_rad=np.empty(count, dtype=single),
            hit_m=np.empty((count, 3), dtype=single),
            surface=np.empty(count, dtype=np.int32),
        )
        written = tuple(getattr(out, f.name) for f in fields(out))
        table = (self.columns, field, *parts, begin, pulses.index, 2 / speed_of_light, written)
        over_rows(lambda low, high: _join(low, high, *table), len(pulses))
        return out


@compiled
@no_type_check
def _join(low, high, columns, field, one, other, at, index, delay_per_metre, out):
    _, east, north, up, range_m, rate, cosine, _, surface, _, factor = columns
    pulse, delay_s, gain, own_rate, incidence, own_hit, own_surface = out
    for beam in range(low, high):
        n = at[beam]
        for part in range(2):
            begin, end = (one[beam], one[beam + 1]) if part == 0 else (other[beam], other[beam + 1])
            for i in range(begin, end):
                pulse[n] = index[beam]
                delay_s[n] = delay_per_metre * range_m[i]
                gain[n] = field[i] * factor[i]
                own_rate[n] = rate[i]
                incidence[n] = np.arccos(cosine[i])
                own_hit[n, 0], own_hit[n, 1], own_hit[n, 2] = east[i], north[i], up[i]
                own_surface[n] = surface[i]
                n += 1
