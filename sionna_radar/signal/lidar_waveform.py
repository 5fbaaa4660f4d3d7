"""Waveform lidar: photoelectrons of the echoes in a beam, receiver noise, and the returns detected in the waveform.

A Lambertian surface of reflectivity q that a share w of the pulse meets at the range R and the incidence t returns

    n = w N q cos(t) D^2 / (4 R^2) exp(-2 a R),     N = efficiency * energy / photon energy

photoelectrons, D the diameter of the receiver and a the extinction: the lidar equation (Wagner et al. 2006, "Gaussian
decomposition and calibration of a novel small-footprint full-waveform digitising airborne laser scanner", with the
cross-section 4 q A cos(t) of a Lambertian target; the paper itself was not at hand). Air of the backscatter b returns
as a surface of q = pi b dR in each dR, and a drop of the backscatter s as one of pi s over the beam's cross-section.

The pulse is Gaussian, and sampled once per standard deviation s. A sample of n photoelectrons, and B of sunlight off
the ground, has the variance F (n + B) + d^2: shot noise with the excess noise factor F of an avalanche diode, and
detector noise d. The clear range sets d: in full sunlight it is where the echo of a 10 % target equals the threshold.
The matched filter h estimates an echo's photoelectrons, and its output at successive samples correlates by exp(-1/4).
White noise passes the threshold z upward between two samples with the probability 2 T(z, sqrt((1 - r) / (1 + r))), T
Owen's function and r the correlation (Owen 1956, "Tables for computing bivariate normal probabilities"); z makes their
sum over the range gate the false-alarm probability.

A return is a maximum of the filtered waveform above z, and above the echo of the weakest target that is reported, that
rises above the saddles beside it by z, too, in units of the noise there. Its range is that of a Gaussian through three
samples. At a maximum of height n and curvature k n (in samples) the peak shifts by sqrt(v') / (k n), v' the variance of
the noise's slope: half of that of white noise, and of the shot noise of a Gaussian echo its (1 - k) / (2 - k)-th. A
point has k = 1/2, and in white noise the Cramer-Rao bound sqrt(2) s over the SNR of amplitudes; one that a slope has
stretched has less, and is ranged worse.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.constants import Planck, speed_of_light
from scipy.ndimage import convolve1d
from scipy.optimize import brentq
from scipy.special import owens_t

from sionna_radar.foundation.columns import Columns
from sionna_radar.signal.lidar import CLEAR_REFLECTIVITY, DROPS_M
from sionna_radar.weather.optical import OpticalAir, drop_backscatter_m2_per_sr

# Solar spectral irradiance of level ground, W/m^2/nm: ASTM G173-03 global, means of 20 nm, read in pvlib 0.16.
SUN_W_PER_M2_NM = {905.0: 0.69, 1550.0: 0.27}
# Standard deviations of a Gaussian pulse in its full width at half maximum, and samples on either side of its middle.
SIGMAS_IN_WIDTH = float(np.sqrt(8 * np.log(2)))
TAIL = 6
PULSE = np.exp(-(np.arange(-TAIL, TAIL + 1) ** 2) / 2) / np.sqrt(2 * np.pi)
MATCHED = PULSE / np.sum(PULSE**2)
# Variance of the filter's output, per variance of a white sample, and per photoelectron of a point's shot noise.
WHITE, SHOT = float(np.sum(MATCHED**2)), float(np.sum(MATCHED**2 * PULSE))
# Correlation of the output at successive samples, and the curvature of the logarithm of a point's echo there.
CORRELATION, POINT_CURVATURE = float(np.exp(-1 / 4)), 0.5
# Drops of less than this share of the threshold are part of the mean echo of the air.
FAINT_DROP = 0.1
# Returns that LAS can number.
MOST_RETURNS = 15


@dataclass(frozen=True, kw_only=True)
class Returns(Columns):
    """Returns found in waveforms, sorted by row and range.

    row: waveform; kind: index of the kind of scatterer that most of the light at the peak is from.
    photoelectrons: of an echo of a point as high as the peak; snr: peak over the noise there, amplitudes.
    """

    row: Int[np.ndarray, " echo"]
    range_m: Float[np.ndarray, " echo"]
    sigma_m: Float[np.ndarray, " echo"]
    photoelectrons: Float[np.ndarray, " echo"]
    snr: Float[np.ndarray, " echo"]
    kind: Int[np.ndarray, " echo"]


@dataclass(frozen=True, kw_only=True)
class WaveformReceiver:
    """A lidar that digitises its echoes, in a given atmosphere; see the keys of `[lidar]`.

    divergence_rad: full width (1 / e^2) of the beam along its two axes.
    field_of_view_sr: solid angle from which sunlight is received.
    """

    pulse_energy_nj: float
    pulse_ns: float
    divergence_rad: tuple[float, float]
    aperture_mm: float
    receiver_aperture_mm: float
    efficiency: float
    excess_noise: float
    sun: float
    filter_nm: float
    field_of_view_sr: float
    clear_range_m: float
    least_reflectivity: float
    near_range_m: float
    false_alarm_probability: float
    returns: Literal["first", "last", "all"]
    max_returns: int
    air: OpticalAir

    @property
    def photon_j(self) -> float:
        """Energy of a photon over the efficiency: of the light at the aperture per photoelectron."""
        return Planck * speed_of_light / (1e-9 * self.air.wavelength_nm) / self.efficiency

    @property
    def sample_s(self) -> float:
        """Interval of samples, and standard deviation of the pulse."""
        return 1e-9 * self.pulse_ns / SIGMAS_IN_WIDTH

    @property
    def step_m(self) -> float:
        """Range between samples."""
        return speed_of_light * self.sample_s / 2

    @property
    def samples(self) -> int:
        """Number of samples, from the near range to that of a white target as weak as a 10 % one at the clear range."""
        far_m = max(self.clear_range_m / np.sqrt(CLEAR_REFLECTIVITY), self.near_range_m + self.step_m)
        return int(np.ceil((far_m - self.near_range_m) / self.step_m)) + 2 * TAIL

    @cached_property
    def range_m(self) -> Float[np.ndarray, " sample"]:
        """Range of each sample."""
        return self.near_range_m + self.step_m * (np.arange(self.samples) - TAIL)

    def white_echo(
        self, range_m: Float[np.ndarray, " n"], extinction_per_m: float | None = None
    ) -> Float[np.ndarray, " n"]:
        """Return the photoelectrons of a white target normal to the beam, by default in the atmosphere."""
        extinction = self.air.extinction_per_m if extinction_per_m is None else extinction_per_m
        aperture_m = 1e-3 * self.receiver_aperture_mm
        pulse = 1e-9 * self.pulse_energy_nj / self.photon_j
        return pulse * aperture_m**2 / (4 * range_m**2) * np.exp(-2 * extinction * range_m)

    def sunlight(self, reflectivity: Float[np.ndarray, " n"], sun: float | None = None) -> Float[np.ndarray, " n"]:
        """Return the photoelectrons of sunlight in a sample, off ground of given reflectivities."""
        irradiance = SUN_W_PER_M2_NM[self.air.wavelength_nm] * self.filter_nm * (self.sun if sun is None else sun)
        collected = np.pi / 4 * (1e-3 * self.receiver_aperture_mm) ** 2 * self.field_of_view_sr
        return irradiance * reflectivity / np.pi * collected * self.sample_s / self.photon_j

    @cached_property
    def threshold(self) -> float:
        """Threshold of the filtered waveform in units of its noise."""
        slope = np.sqrt((1 - CORRELATION) / (1 + CORRELATION))
        steps = self.samples - TAIL  # none is reported in front of the gate
        return float(brentq(lambda z: np.log(2 * steps * owens_t(z, slope) / self.false_alarm_probability), 0.0, 30.0))

    @cached_property
    def detector_variance(self) -> float:
        """Variance of a sample in the dark, in photoelectrons; negative if sunlight alone hides the clear range."""
        weakest = CLEAR_REFLECTIVITY * self.white_echo(np.array([self.clear_range_m]), 0.0)[0]
        bright = self.excess_noise * self.sunlight(np.array([CLEAR_REFLECTIVITY]), 1.0)[0]
        return float((weakest / self.threshold) ** 2 / WHITE - bright)

    @cached_property
    def least_photoelectrons(self) -> Float[np.ndarray, " sample"]:
        """Echo of the weakest target that is reported at the range of each sample; infinite in front of the gate."""
        at_range = self.least_reflectivity * self.white_echo(np.maximum(self.range_m, self.near_range_m), 0.0)
        return np.where(np.arange(len(at_range)) < TAIL, np.inf, at_range)

    def waveforms(
        self,
        row: Int[np.ndarray, " echo"],
        range_m: Float[np.ndarray, " echo"],
        photoelectrons: Float[np.ndarray, " echo"],
        rows: int,
    ) -> Float[np.ndarray, "row sample"]:
        """Return the mean photoelectrons in the samples of some waveforms; echoes outside of the gate are lost."""
        place = (range_m - self.range_m[0]) / self.step_m
        count = len(self.range_m)
        inside = (range_m >= self.near_range_m) & (place < count - TAIL)
        row, place, photoelectrons = row[inside], place[inside], photoelectrons[inside]
        nearest = np.rint(place).astype(np.int64)
        out = np.zeros(rows * count)
        for offset in range(-TAIL, TAIL + 1):
            value = np.exp(-((nearest + offset - place) ** 2) / 2) / np.sqrt(2 * np.pi)
            out += np.bincount(row * count + nearest + offset, photoelectrons * value, minlength=rows * count)
        return out.reshape(rows, count)

    def spread(self, light: Float[np.ndarray, "row sample"]) -> Float[np.ndarray, "row sample"]:
        """Return the light of scatterers around each sample, spread by the pulse."""
        return convolve1d(light, PULSE, axis=1, mode="constant")

    def cross_section_m2(self, range_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the beam's cross-section."""
        one, other = (1e-3 * self.aperture_mm + angle * range_m for angle in self.divergence_rad)
        return np.pi / 4 * one * other

    @cached_property
    def smallest_drop_m(self) -> Float[np.ndarray, " sample"]:
        """Diameter above which drops are echoes of their own; infinite where the largest are too faint."""
        dark = self.threshold * np.sqrt(WHITE * self.detector_variance)
        faint = FAINT_DROP * np.maximum(dark, self.least_photoelectrons)
        range_m = np.maximum(self.range_m, self.near_range_m)
        needed = faint * self.cross_section_m2(range_m) / (np.pi * self.white_echo(range_m))
        return np.interp(needed, drop_backscatter_m2_per_sr(DROPS_M, self.air.wavelength_nm), DROPS_M, right=np.inf)

    @cached_property
    def volume(self) -> Float[np.ndarray, " sample"]:
        """Photoelectrons from the air around each sample before the pulse spreads them, if nothing is in its way."""
        backscatter = np.full(len(self.range_m), self.air.backscatter_per_m_sr)
        if self.air.drops is not None:
            echo = drop_backscatter_m2_per_sr(DROPS_M, self.air.wavelength_nm) * self.air.drops.density_per_m4(DROPS_M)
            backscatter += np.trapezoid(np.where(self.smallest_drop_m[:, None] > DROPS_M, echo, 0.0), DROPS_M, axis=1)
        lit = self.range_m >= self.near_range_m
        range_m = np.where(lit, self.range_m, 1.0)
        return np.where(lit, np.pi * backscatter * self.step_m * self.white_echo(range_m), 0.0)

    @cached_property
    def expected_drops(self) -> Float[np.ndarray, " sample"]:
        """Expected number of drops with an echo of their own up to each sample."""
        drops = self.air.drops
        if drops is None:
            return np.zeros(len(self.range_m))
        larger = np.exp(-drops.slope_per_m * self.smallest_drop_m) * drops.intercept_per_m4 / drops.slope_per_m
        per_m = larger * self.cross_section_m2(self.range_m)
        steps = np.where(np.arange(1, self.samples) > TAIL, (per_m[1:] + per_m[:-1]) / 2 * self.step_m, 0.0)
        return np.concatenate([[0.0], np.cumsum(steps)])

    def draw_drops(
        self, generator: np.random.Generator
    ) -> tuple[Float[np.ndarray, " drop"], Float[np.ndarray, " drop"]]:
        """Return the ranges and photoelectrons of the drops that a pulse meets (Poisson)."""
        expected, drops = self.expected_drops, self.air.drops
        if drops is None:
            return np.zeros(0), np.zeros(0)
        count = generator.poisson(expected[-1])
        range_m = np.interp(generator.random(count) * expected[-1], expected, self.range_m)
        diameter_m = np.interp(range_m, self.range_m, np.minimum(self.smallest_drop_m, DROPS_M[-1]))
        diameter_m = np.minimum(diameter_m + generator.exponential(1 / drops.slope_per_m, count), DROPS_M[-1])
        share = drop_backscatter_m2_per_sr(diameter_m, self.air.wavelength_nm) / self.cross_section_m2(range_m)
        return range_m, np.pi * share * self.white_echo(range_m)

    def detect(
        self,
        light: Float[np.ndarray, "kind row sample"],
        background: Float[np.ndarray, " row"],
        noise: Float[np.ndarray, "row sample"],
    ) -> Returns:
        """Return the returns in some waveforms.

        light: mean photoelectrons by each kind of scatterer; background: of sunlight; noise: white, of unit variance.
        """
        mean = light.sum(axis=0)
        base = self.excess_noise * background + self.detector_variance
        received = mean + np.sqrt(self.excess_noise * mean + base[:, None]) * noise
        filtered = convolve1d(received, MATCHED, axis=1, mode="constant")
        floor = WHITE * base

        def stabilised(level: np.ndarray, dark: np.ndarray) -> np.ndarray:
            """Return levels with noise of unit variance (Anscombe): the integral of 1 / sqrt(dark + rise x)."""
            rise = SHOT * self.excess_noise
            return 2 / rise * (np.sqrt(np.maximum(rise * level + dark, 0.0)) - np.sqrt(dark))

        score = stabilised(filtered, floor[:, None])
        least = stabilised(self.threshold * np.sqrt(floor), floor)
        reported = filtered >= self.least_photoelectrons
        selected = [
            self._select_peaks(score[row], float(least[row]), reported[row])
            if score[row].max() > least[row]
            else np.zeros(0, dtype=np.int64)
            for row in range(len(score))
        ]
        row = np.repeat(np.arange(len(score)), [len(each) for each in selected])
        peak = np.concatenate([np.zeros(0, dtype=np.int64), *selected])
        before, at, after = (np.log(np.maximum(filtered[row, peak + k], 1e-9)) for k in (-1, 0, 1))
        level, curvature = filtered[row, peak], 2 * at - before - after
        # Of an echo of the variance 1 / k - 1: its shot noise at the peak of the output, and in its slope there.
        k = np.minimum(curvature, POINT_CURVATURE)
        shot = self.excess_noise * level * np.sqrt(2 / (2 - k))
        snr = level / np.sqrt(floor[row] + shot)
        return Returns(
            row=row,
            range_m=self.range_m[peak] + self.step_m * (after - before) / 2 / curvature,
            sigma_m=self.step_m * np.sqrt(floor[row] / 2 + shot * (1 - k) / (2 - k)) / (level * k),
            photoelectrons=level,
            snr=snr,
            kind=np.argmax(light[:, row, peak], axis=0),
        )

    def _select_peaks(
        self, score: Float[np.ndarray, " sample"], least: float, reported: Bool[np.ndarray, " sample"]
    ) -> Int[np.ndarray, " echo"]:
        """Return the samples of the peaks that are reported, in order."""
        from scipy.signal import find_peaks  # which takes 0.3 s to import

        peaks, _ = find_peaks(score, height=least, prominence=self.threshold)
        peaks = peaks[reported[peaks]]
        if self.returns != "all":
            return peaks[:1] if self.returns == "first" else peaks[-1:]
        return np.sort(peaks[np.argsort(-score[peaks], kind="stable")[: self.max_returns]])
