"""A second receiver beside the first, and the phase or amplitude of its signal against the direction of arrival.

An interferometer's phase centre lies a baseline b along an axis of the antenna; with the direction cosine u along that
axis its signal leads by k b u (k = 2 pi / wavelength). A phase-comparison monopulse antenna is the same aperture with
its halves subtracted (Sherman and Barton 2011, "Monopulse Principles and Techniques", ch. 5). With the aperture's
distribution a(x) the sum pattern is the Fourier transform of a(x) and the difference pattern that of sgn(x) a(x), less
a quarter of a turn, which is the Hilbert transform of the sum pattern over the direction cosine: for a uniform aperture
D of pattern sin(x) / x, x = k D u / 2, the ratio of both is tan(x / 2).
"""

from dataclasses import dataclass

import numpy as np
import scipy.fft
from jaxtyping import Complex, Float

from sionna_radar.radar.antenna import Cut, lobe_samples

# Standard deviation of the phase over the two-way beam with the default baseline. The phase of an echo of many
# scatterers gives their mean direction with an error of second order in this phase; the error from noise is inverse to
# it. Both are equal at some 25 dB of a point.
SCATTER_RAD = 0.25
# Two-way power down to which the phase must not wrap.
UNAMBIGUOUS = 1e-2
# Zeros beyond the visible cosines, in lengths of the cut, so that the transform does not wrap around.
PADDED = 8
LARGEST_RATIO = 1e6


@dataclass(frozen=True, kw_only=True)
class DifferencePattern:
    """Difference over sum of the antenna's halves along one axis, real after removal of its quarter-cycle phase.

    cosine, ratio: samples over all directions; lobe: those around the peak, where the ratio increases.
    """

    cosine: Float[np.ndarray, " n"]
    ratio: Float[np.ndarray, " n"]
    lobe: slice

    def at(self, cosine: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Return the ratio at direction cosines, linear between the samples."""
        ratios: Float[np.ndarray, ...] = np.interp(cosine, self.cosine, self.ratio)
        return ratios

    def cosine_of(self, ratio: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Return the direction cosine inside the main lobe for a ratio; the lobe's edge for larger ratios."""
        cosines: Float[np.ndarray, ...] = np.interp(ratio, self.ratio[self.lobe], self.cosine[self.lobe])
        return cosines

    @property
    def slope(self) -> float:
        """Derivative of the ratio on boresight, per unit of the direction cosine."""
        middle = len(self.cosine) // 2
        step = self.cosine[middle + 1] - self.cosine[middle - 1]
        return float((self.ratio[middle + 1] - self.ratio[middle - 1]) / step)


@dataclass(frozen=True, kw_only=True)
class SideReceiver:
    """One receiver beside the first.

    axis: of the antenna's frame, 1 for left (azimuth), 2 for up (elevation).
    baseline_m: as assumed in processing; None for the difference of the antenna's halves.
    true_baseline_m, phase_error_rad: true baseline, and residual phase after calibration.
    difference: of the halves; None for an interferometer.
    """

    axis: int
    baseline_m: float | None = None
    true_baseline_m: float = 0.0
    phase_error_rad: float = 0.0
    difference: DifferencePattern | None = None

    def factor(self, direction: Float[np.ndarray, "n 3"]) -> Complex[np.ndarray, " n"]:
        """Return the complex factor on the first receiver's signals, without the phase of the baseline."""
        if self.difference is not None:
            return self.difference.at(direction[:, self.axis]).astype(np.complex128)
        return np.full(len(direction), np.exp(1j * self.phase_error_rad))


def difference_pattern(cut: Cut) -> DifferencePattern:
    """Return the difference of the halves of a separable antenna's aperture over their sum, along one cut."""
    count = len(cut.voltage)
    size = scipy.fft.next_fast_len(PADDED * count)
    spectrum = scipy.fft.fft(cut.voltage, size)
    turn = -1j * np.sign(scipy.fft.fftfreq(size))
    difference = scipy.fft.ifft(spectrum * turn).real[:count]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.nan_to_num(difference / cut.voltage, nan=0.0, posinf=LARGEST_RATIO, neginf=-LARGEST_RATIO)
    return DifferencePattern(
        cosine=cut.cosine,
        ratio=np.clip(ratio, -LARGEST_RATIO, LARGEST_RATIO),
        lobe=lobe_samples(cut, UNAMBIGUOUS),
    )


def baseline_of(spread: float, wavelength_m: float) -> float:
    """Return the baseline for a phase standard deviation of `SCATTER_RAD` over a beam of given spread."""
    return SCATTER_RAD * wavelength_m / (2 * np.pi * spread)
