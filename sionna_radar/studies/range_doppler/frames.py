"""From the beat signals of a frame of chirps to a map of power over range rate and range.

With the range r0 + v t_m in the middle of chirp m, and t from there, the beat's phase is 2 pi (f0 + S t) 2 (r0 + v
t_m) / c and a constant: from chirp to chirp it turns by the Doppler frequency, but faster at the end of an up-sweep
than at its beginning. This is the range migration of a frame. The keystone transform removes it: at each time in the
sweep the chirps are transformed at Doppler frequencies scaled by (f0 + S t) / f0, so that a mover stays in one range
cell (Perry, DiPietro and Fante 1999, "SAR imaging of moving targets", IEEE Trans. Aerosp. Electron. Syst. 35), as far
as its range rate is unambiguous. The scaled transform is Bluestein's, by k m = (k^2 + m^2 - (k - m)^2) / 2.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.fft
from jaxtyping import Complex, Float, Inexact

from sionna_radar.detection.spectrum import SpectrumAnalyser, window_correlation
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.windows import unit_window
from sionna_radar.radar.chirp import Chirp
from sionna_radar.signal.analog_filters import HighPass

MIN_CHIRPS = 4


@dataclass(frozen=True, kw_only=True)
class RangeDopplerMap:
    """Power over range rate and range.

    power: calibrated; a beat of power P in every chirp peaks at P.
    range_rate_mps: of the rows, increasing, positive when receding; unambiguous between its ends.
    range_m: of the bins, for scatterers at rest; see `range_at`.
    """

    power: Float[np.ndarray, "rate bin"]
    range_rate_mps: Float[np.ndarray, " rate"]
    range_m: Float[np.ndarray, " bin"]
    chirp: Chirp

    def range_at(
        self, range_m: Float[np.ndarray, "..."], range_rate_mps: Float[np.ndarray, "..."]
    ) -> Float[np.ndarray, "..."]:
        """Return true ranges of readings on the axis, corrected for the range-Doppler shift."""
        return range_m - self.chirp.doppler_range_m(range_rate_mps)


@dataclass(frozen=True, kw_only=True)
class RangeDoppler:
    """Windows and transforms of frames of chirps.

    chirps: number in a frame.
    interval_s: chirp interval; without it chirps follow at their own rate.
    range_window, rate_window: names for `scipy.signal.get_window`.
    zero_padding: bins of a range cell, and rows of a cell of range rate.
    high_pass: of the receiver; the calibration divides by its response in each bin.

    Examples
    --------
    >>> from sionna_radar.radar import Chirp
    >>> chirp = Chirp(carrier_hz=77e9, bandwidth_hz=300e6, rate_hz=20e3, samples=256)
    >>> frames = RangeDoppler(chirp=chirp, chirps=128)
    >>> round(frames.rate_cell_mps, 3), round(frames.highest_rate_mps, 1)
    (0.304, 19.5)
    >>> round(frames.noise_loss_db, 2)  # of two Hann windows, against rectangular ones
    3.52
    """

    chirp: Chirp
    chirps: int
    range_window: str = "hann"
    rate_window: str = "hann"
    zero_padding: int = 1
    interval_s: float | None = None
    high_pass: HighPass | None = None

    def __post_init__(self) -> None:
        if self.chirps < MIN_CHIRPS:
            raise ScenarioError.of("chirps", f"{self.chirps} do not resolve a range rate; give at least {MIN_CHIRPS}")

    @property
    def rate_cell_mps(self) -> float:
        """Range rate of one cell: half a wavelength over the frame's duration."""
        return self.chirp.wavelength_m * self._sent_hz / (2 * self.chirps)

    @property
    def duration_s(self) -> float:
        """Duration of a frame."""
        return self.chirps / self._sent_hz

    @property
    def _sent_hz(self) -> float:
        """Chirps per second within a frame."""
        return self.chirp.rate_hz if self.interval_s is None else 1 / self.interval_s

    @property
    def highest_rate_mps(self) -> float:
        """Greatest unambiguous range rate of either sign: a quarter of a wavelength from chirp to chirp."""
        return self.chirp.wavelength_m * self._sent_hz / 4

    @cached_property
    def range_weights(self) -> Float[np.ndarray, " sample"]:
        """Weights of the samples of a chirp, with a sum of one."""
        return unit_window(self.range_window, self.chirp.samples)

    @cached_property
    def rate_weights(self) -> Float[np.ndarray, " chirp"]:
        """Weights of the chirps of a frame, with a sum of one."""
        return unit_window(self.rate_window, self.chirps)

    @property
    def noise_loss_db(self) -> float:
        """Loss of a peak's signal-to-noise ratio by both windows, against rectangular ones.

        N sum w^2 / (sum w)^2 each (Harris 1978, "On the use of windows for harmonic analysis with the DFT").
        """
        return float(sum(10 * np.log10(len(w) * np.sum(w**2)) for w in (self.range_weights, self.rate_weights)))

    @property
    def straddling_loss_db(self) -> float:
        """Worst-case loss of a peak, midway between bins and between rows."""
        return float(sum(-20 * np.log10(self._midway(w)) for w in (self.range_weights, self.rate_weights)))

    def _midway(self, weights: Float[np.ndarray, " n"]) -> float:
        turn = np.arange(len(weights)) / (2 * len(weights) * self.zero_padding)
        return float(np.abs(np.exp(-2j * np.pi * turn) @ weights))

    @cached_property
    def range_m(self) -> Float[np.ndarray, " bin"]:
        """Ranges of the bins, for scatterers at rest."""
        return self._along_range.range_m

    @cached_property
    def range_rate_mps(self) -> Float[np.ndarray, " rate"]:
        """Range rates of the rows, increasing."""
        return np.sort(self.chirp.direction * self._turns) * 2 * self.highest_rate_mps

    @cached_property
    def _turns(self) -> Float[np.ndarray, " rate"]:
        """Doppler frequencies of the rows in turns per chirp, in the order of computation."""
        rows = self.chirps * self.zero_padding
        return (np.arange(rows) - rows // 2) / rows

    def noise_correlation(self, cells: int) -> tuple[Float[np.ndarray, " lag"], Float[np.ndarray, " lag"]]:
        """Return the correlations of noise 0, 1, ... cells apart in range rate and in range."""
        return window_correlation(self.rate_weights, cells), window_correlation(self.range_weights, cells)

    def map(self, beat: Inexact[np.ndarray, "chirp sample"]) -> RangeDopplerMap:
        """Return the map of one frame; raises ValueError for another number of chirps or samples."""
        spectrum = self.amplitude(beat)
        return RangeDopplerMap(
            power=spectrum.real**2 + spectrum.imag**2,
            range_rate_mps=self.range_rate_mps,
            range_m=self.range_m,
            chirp=self.chirp,
        )

    def amplitude(self, beat: Inexact[np.ndarray, "chirp sample"]) -> Complex[np.ndarray, "rate bin"]:
        """Return the complex map of one frame, with the phase at its middle."""
        if beat.shape != (self.chirps, self.chirp.samples):
            raise ValueError(f"a frame has {self.chirps} chirps of {self.chirp.samples} samples, not {beat.shape}")
        slow = self._scaled_transform(beat * self.rate_weights[:, None])
        size, bins = self.chirp.samples * self.zero_padding, len(self.range_m)
        # A real beat of power P is a cosine, whose positive frequency carries half of it.
        gain = np.sqrt(2) if self.chirp.sampling == "real" else 1.0
        spectrum = gain * scipy.fft.fft(slow * self._along_range.turned_window, size, axis=1)[:, :bins]
        if self.high_pass is not None:
            spectrum = spectrum / self._along_range.passed
        return spectrum if self.chirp.direction > 0 else spectrum[::-1]

    @cached_property
    def _along_range(self) -> SpectrumAnalyser:
        """Ranges of the bins, behind a range gate too, and the response of the high-pass in each."""
        return SpectrumAnalyser(self.chirp, self.range_window, self.zero_padding, self.high_pass)

    def _scaled_transform(self, beat: Inexact[np.ndarray, "chirp sample"]) -> Complex[np.ndarray, "rate sample"]:
        """Return the transform over the chirps at Doppler frequencies scaled with the frequency of each sample."""
        count, rows = self.chirps, self.chirps * self.zero_padding
        scale = 1 + self.chirp.slope_hz_s * self.chirp.sample_time_s / self.chirp.carrier_hz
        m, k = np.arange(count) - count // 2, np.arange(rows) - rows // 2
        lag = np.arange(k[0] - m[-1], k[-1] - m[0] + 1)
        half = np.pi / rows * scale
        chirped = beat * np.exp(-1j * np.outer(m.astype(float) ** 2, half))
        response = np.exp(1j * np.outer(lag.astype(float) ** 2, half))
        size = scipy.fft.next_fast_len(len(lag) + count - 1)
        product = scipy.fft.fft(chirped, size, axis=0) * scipy.fft.fft(response, size, axis=0)
        transform = scipy.fft.ifft(product, axis=0)[count - 1 : count - 1 + rows]
        return transform * np.exp(-1j * np.outer(k.astype(float) ** 2, half))
