"""Range profiles around the echoes of pulses: what a map needs that models the whole echo.

One value a range cell is kept, in single precision, from one echo length before the nearest echo to one beyond the
farthest, so that a survey of many pulses stays small.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int

from sionna_radar.detection.ranging import EchoRuns

LEAST_MARGIN_CELLS = 16


@dataclass(frozen=True, kw_only=True)
class Profiles:
    """Profiles of the pulses that brought an echo, sorted by pulse.

    first: range cell of each profile's first value; start: where its values begin in `power`, and their end.
    power: calibrated power of the cells; noise: that of the receiver in each profile.
    volume: mean power of rain in the cells, as far as the ground leaves room for it; None in clear air.
    echo_m, echo_sigma_m: where detection puts each profile's ground behind a volume, and how surely; else None.
    cell_m: length of a range cell; ranges are not corrected for Doppler.
    """

    pulse: Int[np.ndarray, " profile"]
    first: Int[np.ndarray, " profile"]
    start: Int[np.ndarray, " profile+1"]
    power: Float32[np.ndarray, " value"]
    noise: Float[np.ndarray, " profile"]
    cell_m: float
    volume: Float32[np.ndarray, " value"] | None = None
    echo_m: Float[np.ndarray, " profile"] | None = None
    echo_sigma_m: Float[np.ndarray, " profile"] | None = None

    def __len__(self) -> int:
        return len(self.pulse)

    def values(self, profile: int) -> Float[np.ndarray, " cell"]:
        """Return the powers of one profile."""
        return self.power[self.start[profile] : self.start[profile + 1]].astype(np.float64)

    def background(self, profile: int) -> float | Float[np.ndarray, " cell"]:
        """Return the mean power that is no ground's in the cells of one profile: of the receiver, and of a volume."""
        noise = float(self.noise[profile])
        if self.volume is None:
            return noise
        return noise + self.volume[self.start[profile] : self.start[profile + 1]].astype(np.float64)

    def only(self, rows: Int[np.ndarray, " kept"]) -> "Profiles":
        """Return some of the profiles, in increasing order."""
        length = np.diff(self.start)[rows]
        start = np.concatenate([[0], np.cumsum(length)])
        index = np.arange(start[-1]) + np.repeat(self.start[:-1][rows] - start[:-1], length)
        return Profiles(
            pulse=self.pulse[rows],
            first=self.first[rows],
            start=start,
            power=self.power[index],
            noise=self.noise[rows],
            cell_m=self.cell_m,
            volume=None if self.volume is None else self.volume[index],
            echo_m=None if self.echo_m is None else self.echo_m[rows],
            echo_sigma_m=None if self.echo_sigma_m is None else self.echo_sigma_m[rows],
        )

    @staticmethod
    def concatenate(tables: Sequence["Profiles"]) -> "Profiles":
        """Return all profiles of some tables, in order."""
        length = np.concatenate([np.diff(t.start) for t in tables])
        return Profiles(
            pulse=np.concatenate([t.pulse for t in tables]),
            first=np.concatenate([t.first for t in tables]),
            start=np.concatenate([[0], np.cumsum(length)]),
            power=np.concatenate([t.power for t in tables]),
            noise=np.concatenate([t.noise for t in tables]),
            cell_m=tables[0].cell_m,
            volume=_joined([t.volume for t in tables]),
            echo_m=_joined([t.echo_m for t in tables]),
            echo_sigma_m=_joined([t.echo_sigma_m for t in tables]),
        )


def _joined(parts: list[np.ndarray | None]) -> np.ndarray | None:
    """Return columns end to end; a survey has all of them or none."""
    known = [part for part in parts if part is not None]
    return np.concatenate(known) if known else None


def cut_profiles(
    runs: EchoRuns,
    pulse: Int[np.ndarray, " pulse"],
    bins_per_cell: int,
    volume: Float[np.ndarray, "pulse bin"] | None = None,
) -> Profiles:
    """Return the profiles around the echoes of a block.

    Parameters
    ----------
    runs:
        The echoes.
    pulse:
        Running numbers of the block's pulses.
    bins_per_cell:
        Bins of the spectra in a range cell.
    volume:
        Mean power of rain in the spectra; None in clear air.

    """
    rows, begin = np.unique(runs.row, return_index=True)
    if len(rows) == 0:
        nothing = np.zeros(0, dtype=np.int64)
        return Profiles(
            pulse=nothing,
            first=nothing,
            start=np.zeros(1, dtype=np.int64),
            power=np.zeros(0, dtype=np.float32),
            noise=np.zeros(0),
            cell_m=runs.bin_m * bins_per_cell,
            volume=None if volume is None else np.zeros(0, dtype=np.float32),
        )
    cells = runs.power.shape[1] // bins_per_cell
    first = np.minimum.reduceat(runs.start, begin) // bins_per_cell
    last = -(-np.maximum.reduceat(runs.stop, begin) // bins_per_cell)
    margin = np.maximum(last - first, LEAST_MARGIN_CELLS)
    first, last = np.maximum(first - margin, 0), np.minimum(last + margin, cells)
    start = np.concatenate([[0], np.cumsum(last - first)])
    row = np.repeat(rows, last - first)
    cell = np.arange(start[-1]) + np.repeat(first - start[:-1], last - first)
    return Profiles(
        pulse=pulse[rows],
        first=first,
        start=start,
        power=runs.power[row, cell * bins_per_cell].astype(np.float32),
        noise=np.min(runs.noise[rows], axis=1),
        cell_m=runs.bin_m * bins_per_cell,
        volume=None if volume is None else volume[row, cell * bins_per_cell].astype(np.float32),
    )
