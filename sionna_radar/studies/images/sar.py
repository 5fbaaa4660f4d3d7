"""Stripmap SAR by back-projection.

For every pulse and pixel the exact two-way delay and its rate follow from the measured position and velocity; the
phase polynomial of `sionna_radar.signal.beat` then gives the beat frequency of the pixel's echo (range, with
the Doppler shift within the sweep) and its phase in the middle of the sweep (of the carrier and the
residual video phase). The pulse's range spectrum is read at that frequency, rotated back by that phase, and summed:

    image = sum of w(u) X(f) exp(-2 pi i c0) / sum of w(u) A(u)

with A the two-way beam over its peak, so that the power of a point's image equals its received power per chirp in the
middle of the beam. Ground focuses only with tracing.speckle = "persistent": its scatterers must stay fixed.
Source of the method: Carrara, Goodman, Majewski, "Spotlight Synthetic Aperture Radar", 1995.
"""

import math
from dataclasses import dataclass
from itertools import starmap
from typing import no_type_check

import numpy as np
from jaxtyping import Complex, Float, Inexact, Int
from numpy import ndarray
from scipy.constants import speed_of_light

from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.compiled import compiled, turned
from sionna_radar.foundation.threads import chunks, over_rows
from sionna_radar.radar.chirp import Chirp
from sionna_radar.signal.analog_filters import HighPass
from sionna_radar.studies.images.aperture import Aperture, PixelGrid, check_sampling

# Spectrum bins per range cell; between them the complex spectrum is linear within 1 % of its peak.
ZERO_PADDING = 8
PULSES_AT_ONCE = 256
PIXELS_AT_ONCE = 8192


@dataclass(frozen=True, kw_only=True)
class SarImage:
    """A focused image, and the settings of its focusing.

    amplitude: sqrt(W), complex, with the phase of the scatterers' gains; 0 without a pulse.
    pulses: number of pulses focused into each pixel.
    """

    grid: PixelGrid
    chirp: Chirp
    aperture: Aperture
    window_name: str
    amplitude: Complex[np.ndarray, "row column"]
    pulses: Int[np.ndarray, "row column"]

    @property
    def power(self) -> Float[np.ndarray, "row column"]:
        """Power of the pixels, W."""
        return self.amplitude.real**2 + self.amplitude.imag**2


class BackProjection:
    """An image accumulated block by block of pulses.

    Memory holds the image and `PULSES_AT_ONCE` spectra; the block size does not change the image.
    """

    def __init__(
        self,
        chirp: Chirp,
        grid: PixelGrid,
        aperture: Aperture,
        window_name: str = "hann",
        high_pass: HighPass | None = None,
        rate_hz: float | None = None,
    ) -> None:
        self._chirp, self._grid, self._aperture, self._rate_hz = chirp, grid, aperture, rate_hz
        self._analyser = SpectrumAnalyser(chirp, window_name, ZERO_PADDING, high_pass)
        # Column by column: neighbours in a chunk are neighbours along the track.
        self._pixels = grid.position_m.transpose(1, 0, 2).reshape(-1, 3)
        self._sum = np.zeros(len(self._pixels), dtype=np.complex128)
        self._weight = np.zeros(len(self._pixels))
        self._pulses = np.zeros(len(self._pixels), dtype=np.int64)

    def add(self, beats: Inexact[np.ndarray, "pulse sample"], measured: Pose) -> None:
        """Add a block of pulses.

        Parameters
        ----------
        beats:
            Beat signals as received.
        measured:
            The measured poses of these pulses.

        Raises
        ------
        ScenarioError
            The pulses are too far apart; see `check_sampling`.
        """
        check_sampling(measured, self._chirp, self._aperture, self._rate_hz)
        for start in range(0, len(beats), PULSES_AT_ONCE):
            rows = slice(start, start + PULSES_AT_ONCE)
            spectra = self.spectra(beats[rows])
            pose = measured.rows(rows)
            for chunk in starmap(slice, chunks(len(self._pixels), PIXELS_AT_ONCE)):
                self._project(spectra, pose, self._lighting(pose, chunk), chunk)

    def spectra(self, beats: Inexact[np.ndarray, "pulse sample"]) -> Complex[np.ndarray, "pulse bin"]:
        """Return the range spectra of beat signals, which are interpolated at the pixels."""
        return np.asarray(self._analyser.amplitude(beats), dtype=np.complex128)

    def image(self) -> SarImage:
        """Return the image of the pulses added so far."""
        columns = self._grid.shape[::-1]
        covered = self._weight > 0
        amplitude = np.divide(self._sum, self._weight, out=np.zeros_like(self._sum), where=covered)
        if self._chirp.direction > 0:  # an up-sweep's beat carries the conjugate of the gain
            amplitude = np.conj(amplitude)
        return SarImage(
            grid=self._grid,
            chirp=self._chirp,
            aperture=self._aperture,
            window_name=self._analyser.window_name,
            amplitude=amplitude.reshape(columns).T,
            pulses=self._pulses.reshape(columns).T,
        )

    def _lighting(self, pose: Pose, chunk: slice) -> Int[np.ndarray, " row"]:
        """Return the pulses whose aperture intersects the sphere around the chunk's pixels."""
        low, high = self._pixels[chunk].min(axis=0), self._pixels[chunk].max(axis=0)
        radius = float(np.linalg.norm(high - low)) / 2
        away = (low + high) / 2 - pose.position_m
        distance = np.linalg.norm(away, axis=1) + radius
        left = np.einsum("pi,pi->p", away, pose.R_world_antenna[:, :, 1])
        return np.flatnonzero(np.abs(left) <= self._aperture.reach * distance + radius)

    def _project(
        self, spectra: Complex[np.ndarray, "pulse bin"], pose: Pose, lit: Int[np.ndarray, " row"], chunk: slice
    ) -> None:
        chirp, aperture = self._chirp, self._aperture
        sweep = (chirp.carrier_hz, chirp.slope_hz_s, float(chirp.direction), chirp.duration_s * ZERO_PADDING)
        weighting = (aperture.reach, aperture.taper, aperture.azimuth.voltage, aperture.weighting == "flat")
        R_world_antenna = pose.R_world_antenna[lit]
        vectors = (pose.position_m[lit], pose.velocity_mps[lit], R_world_antenna[:, :, 0], R_world_antenna[:, :, 1])
        poses = tuple(np.ascontiguousarray(vector.T) for vector in vectors)
        image = (self._sum[chunk], self._weight[chunk], self._pulses[chunk])

        def part(low: int, high: int) -> None:
            project(low, high, self._pixels[chunk], lit, poses, spectra, sweep, weighting, image)

        over_rows(part, chunk.stop - chunk.start)


# Two-way delay per metre of range.
S_PER_M = 2 / speed_of_light


@compiled
@no_type_check
def project(
    low: int,
    high: int,
    pixel_m: Float[ndarray, "pixel 3"],
    row: Int[ndarray, " lit"],
    pose: tuple[Float[ndarray, "3 lit"], Float[ndarray, "3 lit"], Float[ndarray, "3 lit"], Float[ndarray, "3 lit"]],
    spectra: Complex[ndarray, "pulse bin"],
    sweep: tuple[float, float, float, float],
    weighting: tuple[float, Float[ndarray, " node"], Float[ndarray, " n"], bool],
    image: tuple[Complex[ndarray, " pixel"], Float[ndarray, " pixel"], Int[ndarray, " pixel"]],
) -> None:
    """Add pulses to the pixels from low to high, exclusive: their values, their weights and their number.

    row: pulses that illuminate some of them. pose: measured positions and velocities of these, and the directions ahead
    and to the left of their antennas. spectra: of all pulses.
    sweep: carrier in hertz, slope in hertz per second, direction, and spectrum bins per hertz of beat.
    weighting: weight of a pulse against the direction cosine u of a pixel: the reach; the taper at equal steps from
        -reach to reach; the one-way voltage of the beam from -1 to 1; whether the beam is divided out.
    image: sums of weighted values, sums of weights times two-way beam, and numbers of pulses.
    """
    total, weight_sum, count = image
    reach, taper, voltage, flat = weighting
    last_bin = spectra.shape[1] - 1
    # By pulse: position in the spectrum, -1 for unlit pixels; cosine and sine of the phase; direction cosine.
    geometry = np.empty((4, len(row)))
    for pixel in range(low, high):
        _look(pixel_m[pixel], pose, sweep, reach, geometry[0], geometry[1], geometry[2], geometry[3])
        # Continue the running sums, so that they do not depend on the number of pulses added at once.
        real, imaginary, weights = total[pixel].real, total[pixel].imag, weight_sum[pixel]
        for n in range(len(row)):
            place = geometry[0, n]
            if place < 0 or place >= last_bin:
                continue
            below = int(place)
            share = place - below
            spectrum = spectra[row[n]]
            value = spectrum[below] * (1 - share) + spectrum[below + 1] * share
            u = geometry[3, n]
            two_way = _on_equal_steps(voltage, 1.0, u) ** 2
            weight = _on_equal_steps(taper, reach, u)
            if flat:
                weight /= two_way
            cosine, sine = weight * geometry[1, n], weight * geometry[2, n]
            real += value.real * cosine + value.imag * sine
            imaginary += value.imag * cosine - value.real * sine
            weights += weight * two_way
            count[pixel] += 1
        total[pixel], weight_sum[pixel] = complex(real, imaginary), weights


@compiled
@no_type_check
def _look(
    pixel_m: Float[ndarray, " 3"],
    pose: tuple[Float[ndarray, "3 lit"], Float[ndarray, "3 lit"], Float[ndarray, "3 lit"], Float[ndarray, "3 lit"]],
    sweep: tuple[float, float, float, float],
    reach: float,
    place: Float[ndarray, " lit"],
    cosine: Float[ndarray, " lit"],
    sine: Float[ndarray, " lit"],
    u: Float[ndarray, " lit"],
) -> None:
    """Write the position of a pixel's echo in the spectra of pulses, -1 for pulses that do not light it, and its phase.

    Branch-free and contiguous over pulses, for vectorisation.
    """
    position_m, velocity_mps, axis, side = pose
    carrier_hz, slope_hz_s, direction, bins_per_hz = sweep
    px, py, pz = pixel_m[0], pixel_m[1], pixel_m[2]
    for n in range(len(place)):
        x, y, z = px - position_m[0, n], py - position_m[1, n], pz - position_m[2, n]
        left = x * side[0, n] + y * side[1, n] + z * side[2, n]
        ahead = x * axis[0, n] + y * axis[1, n] + z * axis[2, n]
        range_m = math.sqrt(x * x + y * y + z * z)
        per_range = 1 / range_m
        approach = x * velocity_mps[0, n] + y * velocity_mps[1, n] + z * velocity_mps[2, n]
        # As `phase_polynomial`.
        delay_s, stretch = S_PER_M * range_m, -S_PER_M * per_range * approach
        shift_hz = carrier_hz * stretch - slope_hz_s * delay_s * stretch
        at = direction * (shift_hz + slope_hz_s * delay_s) * bins_per_hz
        place[n] = at if (abs(left) <= reach * range_m) & (ahead > 0) else -1.0
        cosine[n], sine[n] = turned(direction * (carrier_hz * delay_s - slope_hz_s * delay_s**2 / 2))
        u[n] = left * per_range


@compiled
@no_type_check
def _on_equal_steps(value: Float[ndarray, " n"], end: float, at: float) -> float:
    """Return the linear interpolation of a function sampled at equal steps from -end to end."""
    last_node = len(value) - 1
    place = (min(max(at, -end), end) + end) * (last_node / (2 * end))
    below = min(int(place), last_node - 1)
    share = place - below
    return value[below] * (1 - share) + value[below + 1] * share
