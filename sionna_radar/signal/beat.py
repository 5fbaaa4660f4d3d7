"""Synthesis of beat signals from paths, as a non-uniform Fourier sum for each chirp.

With the delay tau(t) = 2 r(t) / c of a scatterer, linear over the chirp, the phase between the transmitted and the
received wave is (t from the middle of the sweep, S its slope)

    phi(t) / 2 pi = f0 tau(t) + S t tau(t) - S tau(t)^2 / 2 = c0 + c1 t + c2 t^2

c1 is the beat frequency of Rouveure et al. 2017, eq. 2, with its small cross terms, and c2 the drift of the
beat while the scatterer moves. The paths of a chirp have nearly the same c2: their power-weighted mean is applied
exactly, and the differences from it as a truncated power series.

A range gate mixes with the sweep delayed by t_g. With t from the middle of that one, the phase is that of the sweep at
t less that at t - (tau - t_g): the same polynomial of tau - t_g, without a further constant or residual term.

A receiver's beat is synthesised on a finer and longer grid of times before it is filtered and sampled.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Complex, Float, Inexact, Int
from numpy.polynomial.chebyshev import chebvander
from scipy.constants import speed_of_light

from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.threads import over_rows
from sionna_radar.radar.antenna import Squint
from sionna_radar.radar.chirp import Chirp
from sionna_radar.signal.beat_sum import exponential_sums, weigh
from sionna_radar.tracing.paths import Paths

DRIFT_ACCURACY = 1e-3
# Degree of the polynomial of amplitudes over a sweep, and what each beam width of squint adds.
SQUINT_DEGREE, SQUINT_DEGREES_PER_BEAM = 2, 4


@dataclass(frozen=True)
class PhasePolynomial:
    """Beat phase of each path in cycles, but for its drift: constant, and per second."""

    constant: Float[np.ndarray, " path"]
    frequency_hz: Float[np.ndarray, " path"]


def phase_polynomial(
    delay_s: Float[np.ndarray, " path"], range_rate_mps: Float[np.ndarray, " path"], chirp: Chirp
) -> PhasePolynomial:
    """Return the beat phase of paths; a down-sweep is mixed so that ranges stay positive."""
    f0, slope, sign = chirp.carrier_hz, chirp.slope_hz_s, chirp.direction
    stretch = 2 * np.asarray(range_rate_mps, dtype=np.float64) / speed_of_light
    return PhasePolynomial(
        constant=sign * (f0 * delay_s - slope * delay_s**2 / 2),
        frequency_hz=sign * (f0 * stretch + slope * delay_s - slope * delay_s * stretch),
    )


def gated_delay_s(delay_s: Float[np.ndarray, " path"], chirp: Chirp) -> Float[np.ndarray, " path"]:
    """Return delays after the range gate; the only place where it enters the beats."""
    return delay_s - chirp.gate_s if chirp.gate_s else delay_s


def beat_phase(paths: Paths, chirp: Chirp) -> PhasePolynomial:
    """Return the beat phase of paths in one sweep of their pulse; their delays refer to the whole pulse."""
    delay_s = gated_delay_s(paths.delay_s, chirp)
    if chirp.centre_s:
        delay_s = delay_s + chirp.centre_s * 2 * paths.range_rate_mps.astype(np.float64) / speed_of_light
    return phase_polynomial(delay_s, paths.range_rate_mps, chirp)


def synthesise(paths: Paths, pulses: Pulses, chirp: Chirp) -> Inexact[np.ndarray, "pulse sample"]:
    """Return the noise-free beat signals of a block of pulses for unit transmitted power.

    A path of gain a adds the power |a|^2: a complex exponential of magnitude |a| in I/Q samples, a
    cosine of amplitude sqrt(2) |a| in real ones. An ideal filter removes beats outside the unambiguous band.

    Parameters
    ----------
    paths:
        Paths of the block, sorted by pulse.
    pulses:
        The pulses of the block.
    chirp:
        The sweep.

    Returns
    -------
    Beat signals in sqrt(W) for 1 W of transmitted power; complex for I/Q samples.
    """
    beat = analytic_beats(paths, pulses, chirp)
    return beat if chirp.sampling == "iq" else np.sqrt(2) * beat.real


def analytic_beats(
    paths: Paths, pulses: Pulses, chirp: Chirp, band_hz: tuple[float, float] | None = None
) -> Complex[np.ndarray, "pulse sample"]:
    """Return the beat signals of `synthesise` in complex form: a path of gain a is an exponential of magnitude |a|.

    band_hz: lower (inclusive) and upper (exclusive) limit of the pass band; by default the sampled band.
    """
    if chirp.squint is not None:
        return _squinted_beats(chirp.squint, paths, pulses, replace(chirp, squint=None), band_hz)
    begin = np.searchsorted(paths.pulse, pulses.index, side="left")
    end = np.searchsorted(paths.pulse, pulses.index, side="right")
    frequency, excess, weight = np.empty(len(paths)), np.empty(len(paths)), np.empty(len(paths), dtype=np.complex128)
    mean, total, scattered = np.empty((3, len(pulses)))
    columns = (frequency, weight, excess, mean, total, scattered)
    sweep = (chirp.carrier_hz, chirp.slope_hz_s, float(chirp.direction), chirp.centre_s)
    sampled = (*(band_hz or sampled_band_hz(chirp)), chirp.sampling_rate_hz, speed_of_light)
    table = (gated_delay_s(paths.delay_s, chirp), paths.range_rate_mps, paths.gain, (*sweep, *sampled), columns)
    over_rows(lambda start, stop: weigh(start, stop, begin, end, *table), len(pulses))
    bend = mean / chirp.sampling_rate_hz**2
    beat = exponential_sums(begin, end, frequency, weight, bend, chirp.samples)
    # Phase added by each path's individual drift at the ends of the sweep, in radians.
    ends = 2 * np.pi * (chirp.duration_s / 2) ** 2
    # The root mean square of (2 t / T)^(2 n) over the sweep is 1 / sqrt(4 n + 1).
    drifting = np.flatnonzero(ends * np.sqrt(scattered) > DRIFT_ACCURACY * np.sqrt(5 * total))
    if len(drifting):
        terms = _Drift(begin[drifting], end[drifting], frequency, weight, ends * excess, bend[drifting])
        beat[drifting] += terms.beats(total[drifting], chirp)
    return beat


def _squinted_beats(
    squint: Squint, paths: Paths, pulses: Pulses, chirp: Chirp, band_hz: tuple[float, float] | None
) -> Complex[np.ndarray, "pulse sample"]:
    """Return beats whose amplitude follows the beam over the sweep.

    The amplitude of a path is a polynomial of time through its values at Chebyshev nodes: the sum of a few beats with
    other gains, each times a polynomial. Paths without a place, as of leakage, keep their amplitude. The frequency is
    that of the sweep at each sample, from which that of the echo differs by its beat.
    """
    swept = abs(squint.rad_per_hz) * chirp.bandwidth_hz / squint.antenna.beamwidths_rad[0]
    degree = int(np.ceil(SQUINT_DEGREE + SQUINT_DEGREES_PER_BEAM * swept))
    node = np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1))
    place = 2 * chirp.sample_time_s / chirp.duration_s
    node_weight = np.linalg.solve(chebvander(node, degree).T, chebvander(place, degree).T)
    placed = ~np.isnan(paths.hit_m[:, 0])
    row, pose = pulses.row_of(paths.pulse[placed]), pulses.true
    away = np.einsum("nij,ni->nj", pose.R_world_antenna[row], paths.hit_m[placed] - pose.position_m[row])
    direction = away / np.linalg.norm(away, axis=1, keepdims=True)
    beat = np.zeros((len(pulses), chirp.samples), dtype=np.complex128)
    for at, weight in zip(node, node_weight, strict=True):
        gain = paths.gain.copy()
        gain[placed] *= squint.two_way_ratio(direction, chirp.slope_hz_s * chirp.duration_s / 2 * float(at))
        beat += weight * analytic_beats(replace(paths, gain=gain), pulses, chirp, band_hz)
    return beat


@dataclass(frozen=True)
class _Drift:
    """Correction for paths whose beat drift differs from the mean of their pulse: a power series in the difference.

    excess: the difference in phase at the ends of the sweep.
    """

    first: Int[np.ndarray, " row"]
    last: Int[np.ndarray, " row"]
    frequency: Float[np.ndarray, " path"]
    weight: Complex[np.ndarray, " path"]
    excess: Float[np.ndarray, " path"]
    bend: Float[np.ndarray, " row"]

    def beats(self, total: Float[np.ndarray, " row"], chirp: Chirp) -> Complex[np.ndarray, "row sample"]:
        """Return the sum of all terms above `DRIFT_ACCURACY` relative to the total power of each row."""
        beat = np.zeros((len(total), chirp.samples), dtype=np.complex128)
        squared_time, order = (2 * chirp.sample_time_s / chirp.duration_s) ** 2, 1
        term, rows = self.weight * (1j * self.excess), np.arange(len(total))
        while len(rows):
            begin, end = self.first[rows], self.last[rows]
            beat[rows] += (
                exponential_sums(begin, end, self.frequency, term, self.bend[rows], chirp.samples) * squared_time**order
            )
            order += 1
            term = term * (1j * self.excess / order)
            amplitude = np.array([np.linalg.norm(term[a:b]) for a, b in zip(begin, end, strict=True)])
            rows = rows[amplitude > DRIFT_ACCURACY * np.sqrt((4 * order + 1) * total[rows])]
        return beat


def sampled_band_hz(chirp: Chirp) -> tuple[float, float]:
    """Return the lowest and the highest beat in the sampled band."""
    nyquist_hz = chirp.sampling_rate_hz / 2
    # Complex samples cover 0 to the sampling rate; a real signal folds negative frequencies onto positive.
    return (0.0, 2 * nyquist_hz) if chirp.sampling == "iq" else (-nyquist_hz, nyquist_hz)


@dataclass(frozen=True)
class SampleGrid:
    """An oversampled grid of a sweep's samples, extended beyond both of its ends.

    The sweep begins before its first sample, so that filters have settled by then.
    oversampling: points per sample.
    guard: samples before the first one, and after the last one.
    """

    chirp: Chirp
    oversampling: int = 1
    guard: int = 0

    @cached_property
    def wide(self) -> Chirp:
        """The sweep extended to all points of the grid: same slope and middle, other ends."""
        stretch = (self.chirp.samples + 2 * self.guard) / self.chirp.samples
        return replace(
            self.chirp,
            bandwidth_hz=self.chirp.bandwidth_hz * stretch,
            rate_hz=self.chirp.rate_hz / stretch,
            samples=self.oversampling * (self.chirp.samples + 2 * self.guard),
        )

    @property
    def band_hz(self) -> tuple[float, float]:
        """Lower and upper limit of the points' band, centred on that of the samples."""
        # Complex samples cover 0 to the sampling rate, real ones both signs of beats equally.
        centre_hz = self.chirp.sampling_rate_hz / 2 if self.chirp.sampling == "iq" else 0.0
        half_band_hz = self.oversampling * self.chirp.sampling_rate_hz / 2
        return centre_hz - half_band_hz, centre_hz + half_band_hz

    @property
    def first(self) -> int:
        """Index of the point of the first sample."""
        return self.wide.samples // 2 - self.oversampling * (self.chirp.samples // 2)

    def sampled(self, points: Inexact[np.ndarray, "pulse point"]) -> Inexact[np.ndarray, "pulse sample"]:
        """Return the samples of a signal given on all points of the grid."""
        stop = self.first + self.oversampling * self.chirp.samples
        return points[:, self.first : stop : self.oversampling]

    @cached_property
    def taper(self) -> Float[np.ndarray, " point"]:
        """Weights that fade in over the outer half of the first guard, and out over that of the last."""
        rise = self.oversampling * (self.guard // 2)
        weights = np.ones(self.wide.samples)
        if rise:
            weights[:rise] = np.sin(np.pi / 2 * (np.arange(rise) + 0.5) / rise) ** 2
            weights[-rise:] = weights[:rise][::-1]
        return weights
