"""Division of echoes into stretches of a few range cells with one direction each, and their strips on the ground.

The ground of a range cell lies in the beam as a strip across the direction in which the range grows. Over level ground
the range of a direction d in the antenna's frame is -h / (d . up): it grows along g, the part of up across the
boresight, by r tan(incidence) a radian, and stays along t, at right angles to g. A range cell is a strip along t, and
the two-way beam's power on it, taken for a Gaussian with the variances S of the direction cosines, has along t the
variance 1 / (t' S^-1 t). Tilted ground turns the strip by at most its tilt.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex, Float, Inexact, Int

from sionna_radar.detection.ranging.estimators import EchoSpans, span_cells
from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.columns import Columns

# Limit of the boresight's angle from nadir and horizon: nearer, range has no gradient, or the beam meets no ground.
STEEPEST_RAD = 0.02
# Standard deviation of a point along range on the ground over that across: combined 1.12 times the latter.
LENGTH_OVER_WIDTH = 0.5


@dataclass(frozen=True, kw_only=True)
class RangeStrips(Columns):
    """Strips of range cells across the beams of some pulses, from measured poses; left and up in each pair.

    climb: unit vector of growing range.
    incidence_rad: of the boresight from nadir, limited near nadir and horizon.
    along: standard deviation of the two-way power's direction along the strip.
    mean: position of a strip's mean, per unit of its distance from the boresight along `climb`.
    """

    climb: Float[np.ndarray, "pulse 2"]
    incidence_rad: Float[np.ndarray, " pulse"]
    along: Float[np.ndarray, " pulse"]
    mean: Float[np.ndarray, "pulse 2"]

    @property
    def strip(self) -> Float[np.ndarray, "pulse 2"]:
        """Unit vectors along the strips."""
        return np.column_stack([-self.climb[:, 1], self.climb[:, 0]])

    @property
    def bent_rad(self) -> Float[np.ndarray, " pulse"]:
        """Standard deviation of the direction along `climb` of a strip's power, by the strip's curvature.

        Over level ground a strip is part of a cone about nadir: t along it, it bends by -cot(incidence) t^2 / 2.
        """
        return self.along**2 / np.tan(self.incidence_rad) / np.sqrt(2)

    def length_m(self, range_m: Float[np.ndarray, " pulse"]) -> Float[np.ndarray, " pulse"]:
        """Return the slant ranges that leave the resolution on the ground to the width of the beam.

        Ranges spread evenly over a length l have the standard deviation l / sqrt(12), on level ground that over the
        sine of the incidence.
        """
        width_m = range_m * self.along
        return np.sqrt(12) * LENGTH_OVER_WIDTH * width_m * np.sin(self.incidence_rad)


def range_strips(pose: Pose, spread: tuple[float, float]) -> RangeStrips:
    """Return the strips of pulses.

    pose: measured poses.
    spread: standard deviations of the two-way power over the direction cosines in azimuth and in elevation.
    """
    up = pose.R_world_antenna[:, 2, :]
    across = np.linalg.norm(up[:, 1:], axis=1)
    upright = np.array([0.0, 1.0])
    climb = np.where(across[:, None] > 0, up[:, 1:] / np.maximum(across, 1e-300)[:, None], upright)
    strip = np.column_stack([-climb[:, 1], climb[:, 0]])
    variance = np.array(spread) ** 2
    along = 1 / np.sqrt(np.sum(strip**2 / variance, axis=1))
    mean = variance * climb / np.sum(variance * climb**2, axis=1)[:, None]
    incidence = np.clip(np.arctan2(across, -up[:, 0]), STEEPEST_RAD, np.pi / 2 - STEEPEST_RAD)
    return RangeStrips(climb=climb, incidence_rad=incidence, along=along, mean=mean)


def stretches_of(
    length: Int[np.ndarray, " echo"], most: Float[np.ndarray, " echo"]
) -> tuple[Int[np.ndarray, " point"], Int[np.ndarray, " point"]]:
    """Divide echoes of some lengths, in bins, into equal stretches; return the echo and first bin of each."""
    count = np.maximum(1, np.rint(length / np.maximum(most, 1.0)).astype(np.int64))
    count = np.minimum(count, length)
    echo = np.repeat(np.arange(len(length)), count)
    number = np.arange(len(echo)) - np.repeat(np.cumsum(count) - count, count)
    return echo, number * length[echo] // count[echo]


# Minimum independent looks of a stretch shorter than its echo.
MIN_LOOKS = 2.0


@dataclass(frozen=True, kw_only=True)
class Stretches:
    """Stretches of echoes, and sums over their cells.

    row: pulse of the block; strips: strips of its range cells.
    cell_row, cell_bin, begin: the cells, and the index of each stretch's first one; none in chosen rows.
    length: bins of each.
    power, peak_power: of the first receiver, sum and maximum; noise: mean noise power in a cell.
    range_m, range_variance_m2: mean and variance of the cells' ranges, weighted with their power.
    shift_m: of the cells' ranges by the Doppler shift of stationary ground on the boresight.
    edge_bins: standard deviation of a mean range times the bins of its stretch, in bins.
    """

    row: Int[np.ndarray, " point"]
    strips: RangeStrips
    cell_row: Int[np.ndarray, " cell"]
    cell_bin: Int[np.ndarray, " cell"]
    begin: Int[np.ndarray, " point"]
    length: Int[np.ndarray, " point"]
    power: Float[np.ndarray, " point"]
    peak_power: Float[np.ndarray, " point"]
    noise: Float[np.ndarray, " point"]
    range_m: Float[np.ndarray, " point"]
    range_variance_m2: Float[np.ndarray, " point"]
    shift_m: Float[np.ndarray, " point"]
    bin_m: float
    first_bin: int
    looks_per_bin: float
    edge_bins: float

    @staticmethod
    def of(
        spans: EchoSpans,
        strips: RangeStrips,
        signal: Complex[np.ndarray, "pulse bin"],
        length_m: Float[np.ndarray, " echo"],
        shift_m: Float[np.ndarray, " pulse"],
        edge_bins: float,
    ) -> "Stretches":
        """Divide echoes into stretches of about some lengths."""
        cell_row, cell_bin, start = span_cells(spans.row, spans.start, spans.stop)
        bins = np.maximum(length_m / spans.bin_m, MIN_LOOKS / spans.looks_per_bin)
        echo, first_bin = stretches_of(spans.stop - spans.start, bins)
        begin = start[echo] + first_bin
        value = signal[cell_row, cell_bin]
        power, range_m = value.real**2 + value.imag**2, (spans.first_bin + cell_bin) * spans.bin_m
        total = sums(power, begin)
        mean_m = sums(power * range_m, begin) / total
        length = np.diff(begin, append=len(cell_row))
        offset_m = range_m - np.repeat(mean_m, length)
        row = spans.row[echo]
        return Stretches(
            row=row,
            strips=strips.rows(row),
            cell_row=cell_row,
            cell_bin=cell_bin,
            begin=begin,
            length=length,
            power=total,
            peak_power=np.maximum.reduceat(power, begin) if len(begin) else total,
            noise=receiver_noise(spans.noise)[row],
            range_m=mean_m,
            range_variance_m2=sums(power * offset_m**2, begin) / total,
            shift_m=shift_m[row],
            bin_m=spans.bin_m,
            first_bin=spans.first_bin,
            looks_per_bin=spans.looks_per_bin,
            edge_bins=edge_bins,
        )

    def rows(self, chosen: Int[np.ndarray, " row"], power_fraction: Float[np.ndarray, " row"]) -> "Stretches":
        """Return chosen stretches, possibly repeated, each with a share of its echo's power, without their cells."""
        nothing = np.zeros(0, dtype=np.int64)
        kept = ("row", "length", "noise", "range_m", "range_variance_m2", "shift_m")
        noise_power = self.noise_power[chosen]
        return replace(
            self,
            **{name: getattr(self, name)[chosen] for name in kept},
            strips=self.strips.rows(chosen),
            cell_row=nothing,
            cell_bin=nothing,
            begin=np.zeros(len(chosen), dtype=np.int64),
            power=noise_power + power_fraction * (self.power[chosen] - noise_power),
            peak_power=power_fraction * self.peak_power[chosen],
        )

    @property
    def looks(self) -> Float[np.ndarray, " point"]:
        """Independent looks of each."""
        return np.maximum(1.0, self.length * self.looks_per_bin)

    @property
    def noise_power(self) -> Float[np.ndarray, " point"]:
        """Power of the noise, summed over the bins of each."""
        return self.noise * self.length

    @property
    def snr(self) -> Float[np.ndarray, " point"]:
        """Mean power of the echo over the noise."""
        return np.maximum(self.power / self.noise_power - 1, 1e-6)

    @property
    def climb_per_m(self) -> Float[np.ndarray, " point"]:
        """Gradient of the direction with range over level ground, rad/m."""
        return 1 / ((self.range_m - self.shift_m) * np.tan(self.strips.incidence_rad))

    @property
    def range_sigma_m(self) -> Float[np.ndarray, " point"]:
        """Standard deviation of the mean range; see `SpectrumAnalyser.edge_cells`.

        It counts for the power that is heard: the mean of its inverse over L looks is L / (L - 1).
        """
        looks = np.maximum(self.looks, MIN_LOOKS)
        return self.bin_m * self.edge_bins / self.length * np.sqrt(looks / (looks - 1))

    def cross(
        self,
        signal: Complex[np.ndarray, "pulse bin"],
        first: Complex[np.ndarray, "pulse bin"],
        ramp_rad_m: Float[np.ndarray, " point"],
        bend_rad_m: float = 0.0,
    ) -> tuple[Complex[np.ndarray, " point"], Float[np.ndarray, " point"]]:
        """Return the cross-spectrum of each stretch, its phase at the mean range, and its coherence.

        ramp_rad_m: expected gradient of the phase with range, removed.
        bend_rad_m: phase of the wavefronts' curvature times the range, removed at each cell's range without `shift_m`.
        """
        side, reference = signal[self.cell_row, self.cell_bin], first[self.cell_row, self.cell_bin]
        cell_m = (self.first_bin + self.cell_bin) * self.bin_m
        ramp = np.repeat(ramp_rad_m, self.length) * (cell_m - np.repeat(self.range_m, self.length))
        ramp += bend_rad_m / np.maximum(cell_m - np.repeat(self.shift_m, self.length), self.bin_m)
        # In real arithmetic: complex products may be rounded differently at the end of a block.
        cosine, sine = np.cos(ramp), np.sin(ramp)
        real = side.real * reference.real + side.imag * reference.imag
        imaginary = side.imag * reference.real - side.real * reference.imag
        cross = sums(real * cosine + imaginary * sine, self.begin) + 1j * sums(
            imaginary * cosine - real * sine, self.begin
        )
        power = sums(side.real**2 + side.imag**2, self.begin) * self.power
        return cross, np.abs(cross) / np.sqrt(np.maximum(power, np.finfo(float).tiny))


def receiver_noise(noise: Float[np.ndarray, "pulse bin"]) -> Float[np.ndarray, " pulse"]:
    """Return the noise of each pulse from its estimates around all bins.

    The noise is white; wide echoes raise the estimates beside them, and these are infinite where no training cells fit.
    """
    tested = np.isfinite(noise).all(axis=0)
    if not tested.any():
        return np.full(len(noise), np.inf)
    return np.median(noise[:, tested], axis=1)


def sums(value: Inexact[np.ndarray, " cell"], begin: Int[np.ndarray, " point"]) -> Inexact[np.ndarray, " point"]:
    """Return the sums over stretches of cells."""
    return np.add.reduceat(value, begin) if len(begin) else value[:0]
