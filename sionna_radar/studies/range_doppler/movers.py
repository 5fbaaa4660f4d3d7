"""Targets in a range-Doppler map: CFAR peaks to a fraction of a cell, and range rates beyond one interval's ambiguity.

Range rates beyond those of one interval follow from frames with two alternating chirp intervals (staggered PRI). Every
second chirp belongs to a frame of even intervals P, whose maps are ambiguous by span = wavelength / 2 P. The chirps
between them are T later: from one frame to the other the phase of a scatterer of range rate v turns by
4 pi v T / wavelength, which grows by 2 pi T / P with each folding by a span. So the phase between both frames at a peak
resolves the ambiguity, as do co-prime pulse repetition intervals (the Chinese remainder theorem), but cell by cell.
With T / P = 1 / 2 the ambiguity is that of even intervals T; other ratios separate more rates, by smaller turns. The
phase of two peaks of signal-to-noise ratio R each has a standard deviation of 1 / sqrt(R), and a wrong rate is chosen
where its error exceeds half of the smallest turn.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Inexact
from scipy.ndimage import maximum_filter

from sionna_radar.foundation.columns import Columns
from sionna_radar.radar.chirp import Chirp
from sionna_radar.studies.range_doppler.frames import RangeDoppler, RangeDopplerMap


@dataclass(frozen=True, kw_only=True)
class Movers(Columns):
    """Targets detected in a map, the strongest first.

    range_m: corrected for the range-Doppler shift of a moving target.
    range_rate_mps: positive when receding, within the unambiguous interval.
    power: of the peak, interpolated.
    """

    range_m: Float[np.ndarray, " target"]
    range_rate_mps: Float[np.ndarray, " target"]
    power: Float[np.ndarray, " target"]


def find_movers(power_map: RangeDopplerMap, detected: Bool[np.ndarray, "rate bin"]) -> Movers:
    """Return the targets of a map: detected cells stronger than their eight neighbours.

    Position and height of a peak are those of parabolas through the logarithms of three bins in each direction. With
    "hann" they are within 0.02 cells and 0.6 dB without zero padding, and within 0.002 cells and 0.03 dB with two bins
    in a cell. Range rates wrap.
    """
    power = power_map.power
    highest = power == maximum_filter(power, size=3, mode=("wrap", "nearest"))
    rate, bin_ = np.nonzero(highest & detected)
    interior = (bin_ > 0) & (bin_ < power.shape[1] - 1)
    rate, bin_ = rate[interior], bin_[interior]
    log = np.log(np.maximum(power, np.finfo(float).tiny))
    rows = power.shape[0]
    along_rate = _vertex(log[(rate - 1) % rows, bin_], log[rate, bin_], log[(rate + 1) % rows, bin_])
    along_range = _vertex(log[rate, bin_ - 1], log[rate, bin_], log[rate, bin_ + 1])
    step_mps, step_m = np.diff(power_map.range_rate_mps[:2])[0], np.diff(power_map.range_m[:2])[0]
    rate_mps = wrapped(power_map.range_rate_mps[rate] + along_rate[0] * step_mps, rows * step_mps)
    range_m = power_map.range_at(power_map.range_m[bin_] + along_range[0] * step_m, rate_mps)
    peak = power[rate, bin_] * np.exp(along_rate[1] + along_range[1])
    order = np.argsort(-peak, kind="stable")
    return Movers(range_m=range_m[order], range_rate_mps=rate_mps[order], power=peak[order])


def wrapped(rate_mps: Float[np.ndarray, "..."], span_mps: float) -> Float[np.ndarray, "..."]:
    """Return range rates within half of the ambiguity interval to either side of zero."""
    return np.mod(rate_mps + span_mps / 2, span_mps) - span_mps / 2


def _vertex(
    left: Float[np.ndarray, " n"], centre: Float[np.ndarray, " n"], right: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return the offset of each three-point parabola's peak from the middle sample, and its height above it."""
    bend = left - 2 * centre + right
    slope = (right - left) / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        place = np.where(bend < 0, -slope / bend, 0.0)
    place = np.clip(place, -0.5, 0.5)
    return place, slope * place + bend * place**2 / 2


# Minimum phase between any two separable rates, in turns: 4 standard deviations at 17 dB.
MIN_TURN = 0.1
MAX_FOLDINGS = 64


@dataclass(frozen=True, kw_only=True)
class StaggeredRangeDoppler:
    """Windows and transforms of frames with two alternating chirp intervals.

    half: those of every second chirp, at the interval of a pair.
    first_s: time from the first to the second chirp of a pair, between their middles.

    Examples
    --------
    >>> from sionna_radar.radar import Chirp
    >>> chirp = Chirp(carrier_hz=77e9, bandwidth_hz=300e6, rate_hz=20e3, samples=256)
    >>> half = RangeDoppler(chirp=chirp, chirps=64, interval_s=2.5 / 20e3)
    >>> frames = StaggeredRangeDoppler(half=half, first_s=1 / 20e3)
    >>> frames.foldings, round(half.highest_rate_mps, 1), round(frames.highest_rate_mps, 1)
    (5, 7.8, 38.9)
    """

    half: RangeDoppler
    first_s: float

    @property
    def chirps(self) -> int:
        """Chirps of a frame."""
        return 2 * self.half.chirps

    @property
    def span_mps(self) -> float:
        """Ambiguity interval of the range rate in a map."""
        return 2 * self.half.highest_rate_mps

    @property
    def foldings(self) -> int:
        """Number of ambiguity intervals that the phase resolves: range rates at least `MIN_TURN` apart."""
        assert self.half.interval_s is not None
        turn = self.first_s / self.half.interval_s * np.arange(1, MAX_FOLDINGS)
        close = np.flatnonzero(np.abs(turn - np.round(turn)) < MIN_TURN - 1e-9)
        return int(close[0]) + 1 if len(close) else MAX_FOLDINGS

    @property
    def highest_rate_mps(self) -> float:
        """Greatest unambiguous range rate of either sign."""
        return self.foldings * self.half.highest_rate_mps

    @property
    def chirp(self) -> Chirp:
        """The sweep."""
        return self.half.chirp

    @property
    def rate_cell_mps(self) -> float:
        """Range rate of one cell."""
        return self.half.rate_cell_mps

    @property
    def noise_loss_db(self) -> float:
        """See `RangeDoppler`."""
        return self.half.noise_loss_db

    @property
    def straddling_loss_db(self) -> float:
        """See `RangeDoppler`."""
        return self.half.straddling_loss_db

    def map(self, beat: Inexact[np.ndarray, "chirp sample"]) -> RangeDopplerMap:
        """Return the folded map of one frame: the mean power of the maps of even and odd chirps, two looks."""
        even, odd = (self.half.map(beat[start::2]) for start in (0, 1))
        return RangeDopplerMap(
            power=(even.power + odd.power) / 2,
            range_rate_mps=even.range_rate_mps,
            range_m=even.range_m,
            chirp=even.chirp,
        )

    def unfolded(self, beat: Inexact[np.ndarray, "chirp sample"], movers: Movers) -> Movers:
        """Return the movers of a map with range rates and ranges unfolded by the phase of the strongest in a cell."""
        chirp = self.half.chirp
        read_m = movers.range_m + chirp.doppler_range_m(movers.range_rate_mps)
        row = self._nearest(self.half.range_rate_mps, movers.range_rate_mps)
        bin_ = self._nearest(self.half.range_m, read_m)
        even, odd = (self.half.amplitude(beat[start::2])[row, bin_] for start in (0, 1))
        # All candidate rates of a mover, and the likeness of the measured phase between the frames to that of each.
        fold = np.arange(-MAX_FOLDINGS, MAX_FOLDINGS + 1)
        rate_mps = movers.range_rate_mps[:, None] + fold * self.span_mps
        turned = 4 * np.pi * chirp.direction * self.first_s / chirp.wavelength_m * rate_mps
        likeness = np.cos(np.angle(odd * np.conj(even))[:, None] - turned)
        likeness[(rate_mps < -self.highest_rate_mps) | (rate_mps >= self.highest_rate_mps)] = -np.inf
        chosen_mps = rate_mps[np.arange(len(movers)), np.argmax(likeness, axis=1)]
        return Movers(range_m=read_m - chirp.doppler_range_m(chosen_mps), range_rate_mps=chosen_mps, power=movers.power)

    def _nearest(self, axis: Float[np.ndarray, " bin"], value: Float[np.ndarray, " n"]) -> np.ndarray:
        """Return the nearest bins of an even axis."""
        return np.clip(np.round((value - axis[0]) / (axis[1] - axis[0])).astype(np.int64), 0, len(axis) - 1)
