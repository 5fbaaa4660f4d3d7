"""Tables of detected echoes, and of the range profiles around them, which mapping uses.

A profile holds one value per range cell, in single precision, from one echo length before the nearest echo to one
beyond the farthest, so that a survey of many pulses stays small.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, Int

from sionna_radar.detection.ranging.estimators import EchoSpans
from sionna_radar.foundation.columns import OF, Columns, table_of


@dataclass(frozen=True, kw_only=True)
class Echoes(Columns):
    """Detected echoes, one row each, sorted by pulse and then by range.

    pulse: index of the pulse in the survey.
    number: 0 for the nearest echo of its pulse, 1 for the next, ...
    range_m: slant range, Doppler corrected if the processing says so.
    range_sigma_m: standard deviation of that range, as estimated from the echo itself.
    power: calibrated power of the echo's strongest cell; W, or relative to the transmitted power under snr_db.
    direction: direction of the echo in the antenna's frame (boresight, left, up), a little shorter than one where it is
        a mean of unit vectors; None for echoes on the beam's axis.
    across_sigma_rad: standard deviation of a measured direction in the vertical plane; None for chosen ones.
    reach: correlation length of range errors in pulses, for ranges estimated jointly with neighbours; None where each
        pulse is ranged by itself.
    shared_sigma_m: standard deviation of a range error that all echoes behind a volume share; None in clear air.
    echo_snr_db: that power over the mean noise power estimated from training cells, unbiased for every kind of CFAR.
    """

    pulse: Int[np.ndarray, " echo"]
    number: Int[np.ndarray, " echo"]
    range_m: Float[np.ndarray, " echo"]
    range_sigma_m: Float[np.ndarray, " echo"]
    power: Float[np.ndarray, " echo"]
    echo_snr_db: Float[np.ndarray, " echo"]
    direction: Float[np.ndarray, "echo 3"] | None = None
    across_sigma_rad: Float[np.ndarray, " echo"] | None = None
    reach: Float[np.ndarray, " echo"] | None = None
    shared_sigma_m: Float[np.ndarray, " echo"] | None = None

    def of_pulses(self, pulse: Int[np.ndarray, " pulse"]) -> "Echoes":
        """Return the echoes of consecutive pulses."""
        first, last = np.searchsorted(self.pulse, [pulse[0], pulse[-1] + 1])
        return self.rows(slice(int(first), int(last)))


MIN_MARGIN_CELLS = 16
# Smallest standard deviation that is stated of a range: no model of an echo is right to less, cells.
MIN_SIGMA_CELLS = 0.05


@dataclass(frozen=True, kw_only=True)
class VolumeInFront:
    """The volume in front of the ground in some profiles, such as rain.

    power: mean power in the profiles' cells without ground; in_air: share of it in front of the detected ground.
    echo_m, echo_sigma_m: detected range of the ground in each profile, and its standard deviation.
    direction: of that range, in the antenna's frame (boresight, left, up).
    echo_reach: correlation length of its error in pulses; see `Echoes`.
    drift_m: increase of the volume's ranges by motion, relative to those of stationary ground.
    spread_m: standard deviation of the drift, from particles that fall at different speeds.
    """

    power: Float32[np.ndarray, " value"]
    in_air: Float32[np.ndarray, " value"]
    echo_m: Float[np.ndarray, " profile"]
    echo_sigma_m: Float[np.ndarray, " profile"]
    direction: Float[np.ndarray, "profile 3"]
    echo_reach: Float[np.ndarray, " profile"]
    drift_m: Float[np.ndarray, " profile"]
    spread_m: float

    def rows(self, chosen: Int[np.ndarray, " kept"], values: Int[np.ndarray, " value"]) -> "VolumeInFront":
        """Return the volume of some profiles; `values` indexes their power values."""
        return VolumeInFront(
            power=self.power[values],
            in_air=self.in_air[values],
            echo_m=self.echo_m[chosen],
            echo_sigma_m=self.echo_sigma_m[chosen],
            direction=self.direction[chosen],
            echo_reach=self.echo_reach[chosen],
            drift_m=self.drift_m[chosen],
            spread_m=self.spread_m,
        )

    @staticmethod
    def concatenate(tables: Sequence["VolumeInFront"]) -> "VolumeInFront | None":
        """Concatenate tables in order; a survey has a volume in front of all of its profiles or of none."""
        if not tables:
            return None
        return VolumeInFront(
            power=np.concatenate([t.power for t in tables]),
            in_air=np.concatenate([t.in_air for t in tables]),
            echo_m=np.concatenate([t.echo_m for t in tables]),
            echo_sigma_m=np.concatenate([t.echo_sigma_m for t in tables]),
            direction=np.concatenate([t.direction for t in tables]),
            echo_reach=np.concatenate([t.echo_reach for t in tables]),
            drift_m=np.concatenate([t.drift_m for t in tables]),
            spread_m=tables[0].spread_m,
        )


@dataclass(frozen=True, kw_only=True)
class Profiles:
    """Profiles of the pulses with an echo, sorted by pulse.

    first: range cell of each profile's first value, counted from range zero.
    start: index of that value in `power`, plus the overall end.
    power: calibrated power of the cells; noise: receiver noise power in each profile.
    volume: the volume in front of the ground; None in clear air.
    cell_m: length of a range cell; ranges are not corrected for Doppler.
    """

    pulse: Int[np.ndarray, " profile"]
    first: Int[np.ndarray, " profile"]
    start: Int[np.ndarray, " profile+1"]
    power: Float32[np.ndarray, " value"]
    noise: Float[np.ndarray, " profile"]
    cell_m: float
    volume: "VolumeInFront | None" = None

    def __len__(self) -> int:
        return len(self.pulse)

    def values(self, profile: int) -> Float[np.ndarray, " cell"]:
        """Return the powers of one profile."""
        return self.power[self.start[profile] : self.start[profile + 1]].astype(np.float64)

    def of_cells(
        self, values: Float[np.ndarray, "row cell"], row: Int[np.ndarray, " profile"]
    ) -> Float32[np.ndarray, " value"]:
        """Return the values of range cells (one row per profile) at the cells of the profiles."""
        length = np.diff(self.start)
        cell = np.arange(self.start[-1]) + np.repeat(self.first - self.start[:-1], length)
        return values[np.repeat(row, length), cell].astype(np.float32)

    def rows(self, chosen: Int[np.ndarray, " kept"]) -> "Profiles":
        """Return some of the profiles, in increasing order."""
        length = np.diff(self.start)[chosen]
        start = np.concatenate([[0], np.cumsum(length)])
        index = np.arange(start[-1]) + np.repeat(self.start[:-1][chosen] - start[:-1], length)
        return Profiles(
            pulse=self.pulse[chosen],
            first=self.first[chosen],
            start=start,
            power=self.power[index],
            noise=self.noise[chosen],
            cell_m=self.cell_m,
            volume=None if self.volume is None else self.volume.rows(chosen, index),
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
            volume=VolumeInFront.concatenate([t.volume for t in tables if t.volume is not None]),
        )


def profiles_of(columns: dict[str, Any]) -> Profiles | None:
    """Return the profiles that were serialised with others as `profiles`; None for none."""
    return table_of(Profiles, "profiles", columns) if f"profiles{OF}pulse" in columns else None


def cut_profiles(
    spans: EchoSpans,
    pulse: Int[np.ndarray, " pulse"],
    bins_per_cell: int,
) -> Profiles:
    """Return the profiles around the echoes of a block.

    spans: the echoes.
    pulse: indices of the block's pulses in the survey.
    bins_per_cell: spectrum bins per range cell.
    """
    rows, begin = np.unique(spans.row, return_index=True)
    if len(rows) == 0:
        nothing = np.zeros(0, dtype=np.int64)
        return Profiles(
            pulse=nothing,
            first=nothing,
            start=np.zeros(1, dtype=np.int64),
            power=np.zeros(0, dtype=np.float32),
            noise=np.zeros(0),
            cell_m=spans.bin_m * bins_per_cell,
        )
    cells = spans.power.shape[1] // bins_per_cell
    first = np.minimum.reduceat(spans.start, begin) // bins_per_cell
    last = -(-np.maximum.reduceat(spans.stop, begin) // bins_per_cell)
    margin = np.maximum(last - first, MIN_MARGIN_CELLS)
    first, last = np.maximum(first - margin, 0), np.minimum(last + margin, cells)
    start = np.concatenate([[0], np.cumsum(last - first)])
    row = np.repeat(rows, last - first)
    cell = np.arange(start[-1]) + np.repeat(first - start[:-1], last - first)
    return Profiles(
        pulse=pulse[rows],
        first=first + spans.first_bin // bins_per_cell,
        start=start,
        power=spans.power[row, cell * bins_per_cell].astype(np.float32),
        noise=np.min(spans.noise, axis=1)[rows],
        cell_m=spans.bin_m * bins_per_cell,
    )
