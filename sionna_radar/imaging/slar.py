"""The image of a side-looking real-aperture radar: power against along-track position and slant range.

Its resolution is the beam's footprint along the track, and c / (2 B) times the window's factor in range. On level
ground a point at slant range r, seen from the height h, lies at the ground range sqrt(r^2 - h^2); a range cell there
is 1 / sin(incidence) times as wide, and elevated points shift toward the track (layover).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Inexact

from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.flight.pulses import Pose


@dataclass(frozen=True, kw_only=True)
class SlantImage:
    """Range-compressed pulses side by side, averaged in power over equal intervals of the track.

    power: W; NaN in intervals without a pulse.
    along_m: middle of each interval, from the first pulse.
    range_m: slant range, corrected for Doppler.
    height_m: mean height of the radar in each interval, world frame.
    """

    power: Float[np.ndarray, "along range"]
    along_m: Float[np.ndarray, " along"]
    range_m: Float[np.ndarray, " range"]
    height_m: Float[np.ndarray, " along"]


@dataclass(frozen=True, kw_only=True)
class GroundImage:
    """A slant-range image projected onto level ground.

    power: W, on the scale of the slant-range image; NaN nearer than the ground or beyond the last range.
    ground_m: distance from nadir.
    """

    power: Float[np.ndarray, "along ground"]
    along_m: Float[np.ndarray, " along"]
    ground_m: Float[np.ndarray, " ground"]


class SideLooking:
    """A slant-range image accumulated block by block of pulses.

    step_m: length of the intervals over which pulses are averaged.
    """

    def __init__(self, analyser: SpectrumAnalyser, step_m: float) -> None:
        self._analyser, self._step_m = analyser, step_m
        self._start_m: Float[np.ndarray, " 3"] | None = None
        self._rows: dict[int, tuple[Float[np.ndarray, " range"], float, int]] = {}

    def add(self, beats: Inexact[np.ndarray, "pulse sample"], measured: Pose) -> None:
        """Add a block of pulses with their measured poses."""
        if len(beats) == 0:
            return
        if self._start_m is None:
            self._start_m = measured.position_m[0]
        power = self._corrected(self._analyser.power(beats), measured)
        along = np.linalg.norm((measured.position_m - self._start_m)[:, :2], axis=1)
        interval = np.floor(along / self._step_m).astype(int)
        for number in np.unique(interval):
            members = interval == number
            total, height, count = self._rows.get(int(number), (np.zeros(power.shape[1]), 0.0, 0))
            self._rows[int(number)] = (
                total + power[members].sum(axis=0),
                height + float(measured.position_m[members, 2].sum()),
                count + int(members.sum()),
            )

    def image(self) -> SlantImage:
        """Return the image of the pulses added so far.

        Raises
        ------
        ValueError
            No pulse was added.
        """
        if not self._rows:
            message = "no pulses to image; add some"
            raise ValueError(message)
        count = max(self._rows) + 1
        power = np.full((count, len(self._analyser.range_m)), np.nan)
        height = np.full(count, np.nan)
        for number, (total, heights, pulses) in self._rows.items():
            power[number], height[number] = total / pulses, heights / pulses
        return SlantImage(
            power=power,
            along_m=(np.arange(count) + 0.5) * self._step_m,
            range_m=self._analyser.range_m,
            height_m=height,
        )

    def _corrected(self, power: Float[np.ndarray, "pulse bin"], measured: Pose) -> Float[np.ndarray, "pulse bin"]:
        """Return spectra corrected for the Doppler shift of the boresight, from the measured velocity."""
        range_m = self._analyser.range_m
        shift = self._analyser.chirp.doppler_range_m(measured.boresight_range_rate_mps)
        if np.all(np.abs(shift) < 1e-3 * self._analyser.bin_m):
            return power
        moved = [np.interp(range_m + s, range_m, row) for s, row in zip(shift, power, strict=True)]
        return np.array(moved)


def to_ground(image: SlantImage, ground_height_m: float, ground_m: Float[np.ndarray, " ground"]) -> GroundImage:
    """Project a slant-range image onto level ground.

    Parameters
    ----------
    image:
        The image.
    ground_height_m:
        Height of the ground, world frame.
    ground_m:
        Ground ranges of the columns.
    """
    power = np.full((len(image.along_m), len(ground_m)), np.nan)
    for row in np.flatnonzero(np.isfinite(image.height_m)):
        slant = np.hypot(ground_m, image.height_m[row] - ground_height_m)
        power[row] = np.interp(slant, image.range_m, image.power[row], right=np.nan)
    return GroundImage(power=power, along_m=image.along_m, ground_m=ground_m)
