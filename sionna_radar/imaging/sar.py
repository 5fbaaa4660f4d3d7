"""Stripmap SAR by back-projection.

For every pulse and pixel the exact two-way delay and its rate follow from the measured position and velocity; the
phase polynomial of `sionna_radar.signal.beat` then gives the beat frequency of the pixel's echo (range, with
the Doppler shift within the sweep) and its phase in the middle of the sweep (of the carrier and the
residual video phase). The pulse's range spectrum is read at that frequency, rotated back by that phase, and summed:

    image = sum of w(u) X(f) exp(-2 pi i c0) / sum of w(u) A(u)

with A the two-way beam over its peak, so that the power of a point's image is what a chirp receives from it in the
middle of the beam. Ground focuses only with tracing.speckle = "persistent": its scatterers must stay fixed.
Source of the method: Carrara, Goodman, Majewski, "Spotlight Synthetic Aperture Radar", 1995.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float, Inexact, Int

from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.threads import over_rows
from sionna_radar.imaging.aperture import Aperture, check_sampling
from sionna_radar.imaging.grid import PixelGrid
from sionna_radar.radar.chirp import Chirp
from sionna_radar.signal.high_pass import HighPass

# Spectrum bins per range cell; between them the complex spectrum is linear within 1 % of its peak.
ZERO_PADDING = 8
PULSES_AT_ONCE = 256
PIXELS_AT_ONCE = 8192


@dataclass(frozen=True, kw_only=True)
class SarImage:
    """A focused image, and the settings of its focusing.

    amplitude: sqrt(W), complex, with the phase of the scatterers' gains; 0 where no pulse looks.
    pulses: number of pulses each pixel was focused from.
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
    ) -> None:
        self._chirp, self._grid, self._aperture = chirp, grid, aperture
        self._analyser = SpectrumAnalyser(chirp, window_name, ZERO_PADDING, high_pass)
        # Column by column, so that neighbours in a chunk are neighbours along the track.
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
        check_sampling(measured, self._chirp, self._aperture)
        for start in range(0, len(beats), PULSES_AT_ONCE):
            rows = slice(start, start + PULSES_AT_ONCE)
            spectra = self.spectra(beats[rows])
            pose = Pose(
                position_m=measured.position_m[rows],
                velocity_mps=measured.velocity_mps[rows],
                R_world_antenna=measured.R_world_antenna[rows],
            )
            for chunk in self._chunks():
                self._project(spectra, pose, self._lighting(pose, chunk), chunk)

    def spectra(self, beats: Inexact[np.ndarray, "pulse sample"]) -> Complex[np.ndarray, "pulse bin"]:
        """Return the range spectra of beat signals, in which the values of pixels are looked up."""
        return np.asarray(self._analyser.amplitude(beats), dtype=np.complex128)

    def image(self) -> SarImage:
        """Return the image of the pulses added so far."""
        columns = self._grid.shape[::-1]
        seen = self._weight > 0
        amplitude = np.divide(self._sum, self._weight, out=np.zeros_like(self._sum), where=seen)
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

    def _chunks(self) -> Iterator[slice]:
        for start in range(0, len(self._pixels), PIXELS_AT_ONCE):
            yield slice(start, min(start + PIXELS_AT_ONCE, len(self._pixels)))

    def _lighting(self, pose: Pose, chunk: slice) -> Int[np.ndarray, " row"]:
        """Return the pulses whose aperture reaches into the sphere around some pixels."""
        low, high = self._pixels[chunk].min(axis=0), self._pixels[chunk].max(axis=0)
        radius = float(np.linalg.norm(high - low)) / 2
        away = (low + high) / 2 - pose.position_m
        distance = np.linalg.norm(away, axis=1) + radius
        left = np.einsum("pi,pi->p", away, pose.R_world_antenna[:, :, 1])
        return np.flatnonzero(np.abs(left) <= self._aperture.reach * distance + radius)

    def _project(
        self, spectra: Complex[np.ndarray, "pulse bin"], pose: Pose, lit: Int[np.ndarray, " row"], chunk: slice
    ) -> None:
        # Numba takes half a second to import.
        from sionna_radar.imaging.projection_kernels import project

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


def focus(
    beats: Inexact[np.ndarray, "pulse sample"],
    measured: Pose,
    chirp: Chirp,
    grid: PixelGrid,
    aperture: Aperture,
    *,
    window_name: str = "hann",
) -> SarImage:
    """Focus pulses into a complex image; `BackProjection` does the same block by block.

    Parameters
    ----------
    beats, measured:
        Beat signals and the measured poses of their pulses.
    chirp:
        The sweep.
    grid:
        Pixels of the image.
    aperture:
        The part of the beam to use; `whole_beam(antenna)` for all of it.
    window_name:
        Window over the sweep, any of `scipy.signal.get_window`.

    Raises
    ------
    ScenarioError
        The chirp rate does not sample the azimuth bandwidth.

    """
    projection = BackProjection(chirp, grid, aperture, window_name)
    projection.add(beats, measured)
    return projection.image()
