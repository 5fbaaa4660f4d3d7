"""Range spectra of beat signals, on a calibrated power scale, with NumPy or, on a GPU, CuPy."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.fft
from jaxtyping import Complex, Float, Inexact, Num

from sionna_radar.foundation.threads import chunks_of_bytes, over_rows
from sionna_radar.foundation.windows import unit_window
from sionna_radar.radar.chirp import Chirp
from sionna_radar.signal.analog_filters import HighPass, SampledNoise

# Spectra computed at once, which fit into a processor's cache.
# Half-length of the window's response, in range cells, and its steps per cell.
SEEN_CELLS, STEPS_PER_CELL = 8, 4


@dataclass(frozen=True)
class ArrayLibrary:
    """A library of arrays.

    arrays, fft: modules with the interfaces of `numpy` and `scipy.fft`.
    """

    arrays: Any
    fft: Any

    def taken(self, tensor: Any) -> Any:
        """Return a Dr.Jit tensor as an array of this library, on a GPU without a copy."""
        return tensor.numpy() if self.arrays is np else self.arrays.from_dlpack(tensor)

    def from_host(self, array: Num[np.ndarray, "..."]) -> Any:
        """Return a host array as an array of this library."""
        return self.arrays.asarray(array)

    def fetched(self, array: Any) -> Num[np.ndarray, "..."]:
        """Return an array of this library as a host array."""
        return np.asarray(array) if self.arrays is np else np.asarray(self.arrays.asnumpy(array))


HOST = ArrayLibrary(np, scipy.fft)


def gpu_library() -> ArrayLibrary | None:
    """Return CuPy; None where it is not installed."""
    try:
        import cupy
        import cupyx.scipy.fft
    except ImportError:
        return None
    return ArrayLibrary(cupy, cupyx.scipy.fft)


@dataclass(frozen=True)
class SpectrumAnalyser:
    """Window, zero-padding and FFT; a beat of power P peaks at P.

    zero_padding: spectrum bins per range cell (c / 2B).
    high_pass: of the receiver; the calibration divides by its response in each bin.
    averaged: consecutive chirps whose powers are averaged in a pulse.
    noise: of the samples behind the high-pass; None where it is not known, or white.
    """

    chirp: Chirp
    window_name: str
    zero_padding: int
    high_pass: HighPass | None = None
    averaged: int = 1
    noise: SampledNoise | None = None

    @cached_property
    def window(self) -> Float[np.ndarray, " sample"]:
        """Weights of the samples, with a sum of one."""
        return unit_window(self.window_name, self.chirp.samples)

    @cached_property
    def range_m(self) -> Float[np.ndarray, " bin"]:
        """Range of each bin for a stationary scatterer."""
        cells = self.chirp.samples // (2 if self.chirp.sampling == "real" else 1)
        return (self.first_bin + np.arange(cells * self.zero_padding)) * self.bin_m

    @property
    def first_bin(self) -> int:
        """Number of the first bin, counted from range zero: zero but behind a range gate."""
        return self.chirp.first_cell * self.zero_padding

    @cached_property
    def turned_window(self) -> Inexact[np.ndarray, " sample"]:
        """The window, turned so that the first bin has its beat at zero."""
        if not self.chirp.lead_cells:
            return self.window
        turns = self.chirp.lead_cells * self.chirp.sample_time_s / self.chirp.duration_s
        return self.window * np.exp(-2j * np.pi * turns)

    @property
    def bin_m(self) -> float:
        """Distance between bins."""
        return self.chirp.range_resolution_m / self.zero_padding

    def power(self, beat: Inexact[np.ndarray, "chirp sample"]) -> Float[np.ndarray, "pulse bin"]:
        """Return the power spectra of beat signals, on all cores; averaged over the chirps of each pulse."""
        power = np.empty((len(beat), len(self.range_m)))
        if self.high_pass is not None:
            _ = self.passed  # cached before several threads use it

        def transform(low: int, high: int) -> None:
            """Write the powers of some beat signals."""
            for start, stop in chunks_of_bytes(high - low, 16 * len(self.range_m)):
                rows = slice(low + start, low + stop)
                spectrum = self._transform(beat[rows])
                if self.high_pass is not None:
                    power[rows] = np.abs(spectrum / self.passed) ** 2
                else:
                    power[rows] = spectrum.real**2 + spectrum.imag**2

        over_rows(transform, len(beat))
        return power if self.averaged == 1 else power.reshape(-1, self.averaged, power.shape[1]).mean(axis=1)

    def power_on_device(self, beat: Any, library: ArrayLibrary) -> Float[np.ndarray, "pulse bin"]:
        """Return the power spectra of beat signals held in another library's arrays, without a high-pass."""
        spectrum = self._transform(beat, library)
        return library.fetched(spectrum.real**2 + spectrum.imag**2).astype(np.float64)

    def amplitude(self, beat: Inexact[np.ndarray, "pulse sample"]) -> Complex[np.ndarray, "pulse bin"]:
        """Return the complex spectra of beat signals, with the phase at the middle of the sweep."""
        middle = self.chirp.samples // 2
        turns = np.arange(len(self.range_m)) * (middle / (self.chirp.samples * self.zero_padding))
        spectrum = self._transform(beat) * np.exp(2j * np.pi * np.mod(turns, 1.0))
        return spectrum if self.high_pass is None else spectrum / self.passed

    @cached_property
    def passed(self) -> Complex[np.ndarray, " bin"]:
        """Response of the high-pass in each bin, averaged over the window's main lobe and side lobes.

        Its square is the power response weighted by the window's: noise that is white before the filter is white in the
        calibrated spectrum, down to the bins next to zero, where the response itself vanishes.
        """
        assert self.high_pass is not None
        cell_hz = 1 / self.chirp.duration_s
        bin_hz = (np.arange(len(self.range_m)) / self.zero_padding + self.chirp.lead_cells) * cell_hz
        response = self.response(SEEN_CELLS * STEPS_PER_CELL, STEPS_PER_CELL)
        offset_hz = np.arange(-SEEN_CELLS * STEPS_PER_CELL, SEEN_CELLS * STEPS_PER_CELL + 1) / STEPS_PER_CELL * cell_hz
        mean = sum(s * self.high_pass.power_response(bin_hz + o) for s, o in zip(response, offset_hz, strict=True))
        return np.sqrt(mean) * np.exp(1j * np.angle(self.high_pass.response(bin_hz)))

    @property
    def passed_power(self) -> Float[np.ndarray, " bin"]:
        """Power response of the high-pass in each bin, by which the calibration divides."""
        return np.ones(len(self.range_m)) if self.high_pass is None else np.abs(self.passed) ** 2

    @cached_property
    def noise_rise(self) -> Float[np.ndarray, " bin"] | None:
        """Noise in each bin of the calibrated spectrum over thermal noise; None where it is white.

        The calibration divides by the high-pass what has not passed it, too: the rounding of the converter, noise that
        folds onto low beats, and noise of far cells that the side lobes of the window let in.
        """
        if self.high_pass is None or self.noise is None:
            return None
        stride, samples = self.zero_padding, self.chirp.samples
        # Noise is periodic over the samples: it has lines, one range cell apart.
        density = self.noise.density(np.arange(samples) / self.chirp.duration_s)
        rise = np.empty(len(self.range_m))
        for phase in range(stride):
            whole, part = divmod(phase / stride + self.chirp.lead_cells, 1.0)
            heard = np.abs(scipy.fft.fft(self.window * np.exp(-2j * np.pi * part * np.arange(samples) / samples))) ** 2
            heard /= heard.sum()
            line = int(whole) + np.arange(len(rise[phase::stride]))
            # What a transform rounds off the sum over all lines would hide those next to zero.
            near = np.arange(-SEEN_CELLS, SEEN_CELLS + 1)
            total = np.sum([heard[n] * density[(line - n) % samples] for n in near], axis=0)
            heard[near] = 0.0
            far = scipy.fft.irfft(scipy.fft.rfft(heard) * scipy.fft.rfft(density), samples)
            rise[phase::stride] = total + np.maximum(far[line % samples], 0.0)
        # A line at zero beat that neither filter nor window passes holds no noise.
        return np.where(rise > 0, rise / self.passed_power, 1.0)

    def _transform(self, beat: Any, library: ArrayLibrary = HOST) -> Any:
        """Return the spectra of beat signals, pulse by bin, in the library's arrays."""
        bins, size = len(self.range_m), self.chirp.samples * self.zero_padding
        windowed = beat * library.from_host(self.turned_window)
        if self.chirp.sampling == "real":
            # A real beat of power P is a cosine whose positive frequency carries half of it.
            transform = library.fft.fft if self.chirp.lead_cells else library.fft.rfft
            return np.sqrt(2) * transform(windowed, size)[:, :bins]
        return library.fft.fft(windowed, size)[:, :bins]

    def noise_correlation(self, cells: int) -> Float[np.ndarray, " lag"]:
        """Return the correlation of windowed white noise 0, 1, ... range cells apart."""
        return window_correlation(self.window, cells)

    @cached_property
    def looks_per_cell(self) -> float:
        """Independent looks per range cell: the window correlates neighbouring cells."""
        lags = self.noise_correlation(min(32, self.chirp.samples))
        return float(1 / (1 + 2 * np.sum(lags[1:] ** 2)))

    @cached_property
    def edge_cells(self) -> float:
        """Standard deviation of the mean range of cells less that of the scatterers they hear, times their number.

        Both means, weighted with the power, differ at the ends of the cells only, where scatterers are heard in part.
        A cell's signal is S = sum a_i w(x_i), x_i the ranges of scatterers from it in cells and w the spectrum of the
        window, and the means differ by the sum of Re(D S*) over that of |S|^2, D = sum a_i x_i w(x_i). Of Gaussian a_i
        the variance of the sum over n cells is that of sum_m (n - |m|) (c_DD c_SS - c_DS^2)(m) / 2, of which, as it
        vanishes over all m, what is left is the part with |m|.
        """
        samples, half = self.chirp.samples, SEEN_CELLS * STEPS_PER_CELL
        x = np.arange(-half, half + 1) / STEPS_PER_CELL
        middle = np.arange(samples) - (samples - 1) / 2
        w = np.cos(2 * np.pi * np.outer(x, middle) / samples) @ self.window
        c_ss, c_dd, c_ds = (np.correlate(one, other, "full") for one, other in ((w, w), (x * w, x * w), (x * w, w)))
        lag = np.abs(np.arange(len(c_ss)) - len(w) + 1)
        variance = -np.sum(lag * (c_dd * c_ss - c_ds**2)) / (2 * c_ss.max() ** 2)
        return float(np.sqrt(max(variance, 0.0)) / STEPS_PER_CELL)

    def response(self, half: int, bins_per_cell: int) -> Float[np.ndarray, " bin"]:
        """Return the power spectrum of a point target on bins -half to half around its own, with a sum of one."""
        samples = self.chirp.samples
        turn = np.arange(-half, half + 1) / (samples * bins_per_cell)
        spectrum = np.exp(-2j * np.pi * np.outer(turn, np.arange(samples))) @ self.window
        power = spectrum.real**2 + spectrum.imag**2
        return power / power.sum()


def window_correlation(weights: Float[np.ndarray, " n"], cells: int) -> Float[np.ndarray, " lag"]:
    """Return the correlation of white noise 0, 1, ... cells apart in the spectrum of weighted samples."""
    energy = weights**2 / np.sum(weights**2)
    middle = np.arange(len(weights)) - (len(weights) - 1) / 2
    return np.array([energy @ np.cos(2 * np.pi * lag * middle / len(weights)) for lag in range(cells)])
