"""The imaged strip of a side-looking radar beside a straight track: its slant-range image, its pixels, the resolution.

The image of a real aperture is power against along-track position and slant range. Its resolution is the beam's
footprint along the track, and c / (2 B) times the window's factor in range. On level ground a point at slant range r,
seen from the height h, lies at the ground range sqrt(r^2 - h^2); a range cell there is 1 / sin(incidence) times as
wide, and elevated points shift toward the track (layover).

Resolutions are given in closed form or by one quadrature; `half_power_width` measures that of a response. Widths are
half-power widths throughout. A side-looking radar at broadside samples the spatial frequency 2 u / lambda along the
track at a scatterer's direction cosine u; the image of a point is the Fourier transform of the weight W(u) applied by
the beam and the processing,

    h(x) = integral of W(u) exp(4 pi i u x / lambda) du

A flat weight over |u| <= U gives a sinc with its first null at lambda / (4 U). An antenna of length d has the beam
2 U = lambda / d, hence the null at d / 2: half the real aperture's length. Without equalisation its two-way beam is
the squared transform of the taper, so h(x) is the taper convolved with itself, at 2 x: for a uniform taper a triangle
that ends at d / 2, of half-power width (2 - sqrt 2) d / 2.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Inexact
from scipy.optimize import brentq
from scipy.signal import get_window

from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.radar.antenna import Cut
from sionna_radar.radar.chirp import Chirp
from sionna_radar.studies.images.aperture import Aperture, PixelGrid, ground_pixels

NODES = 4001


def window_factor(window_name: str) -> float:
    """Return the half-power width of a window's spectrum in units of one over its length: 0.886 for a boxcar."""
    weights = get_window(window_name, NODES - 1)
    place = (np.arange(NODES - 1) - (NODES - 1) // 2) / (NODES - 1)

    def response(bins: float) -> float:
        return float(weights @ np.cos(2 * np.pi * bins * place) / weights.sum())

    return 2 * _half_power(response, 0.25)


def slant_range_resolution_m(chirp: Chirp, window_name: str) -> float:
    """Return the half-power width in slant range: c / (2 B) times the window's factor."""
    return chirp.range_resolution_m * window_factor(window_name)


def ground_range_resolution_m(chirp: Chirp, window_name: str, incidence_rad: float) -> float:
    """Return the half-power width on level ground: c / (2 B sin(incidence)) times the window's factor."""
    return slant_range_resolution_m(chirp, window_name) / float(np.sin(incidence_rad))


def real_aperture_resolution_m(azimuth: Cut, range_m: float) -> float:
    """Return the half-power width along the track of an unfocused point: the two-way beam's at its range."""
    return range_m * half_power_width(azimuth.cosine, azimuth.voltage**4)


def azimuth_resolution_m(aperture: Aperture, wavelength_m: float) -> float:
    """Return the half-power width along the track of a focused point; see the module docstring."""
    u = np.linspace(-aperture.reach, aperture.reach, NODES)
    weight = aperture.weight(u) * aperture.two_way(u)

    def response(place_m: float) -> float:
        return float(weight @ np.cos(4 * np.pi * u * place_m / wavelength_m) / weight.sum())

    return 2 * _half_power(response, wavelength_m / (16 * aperture.reach))


def half_power_width(place: Float[np.ndarray, " n"], power: Float[np.ndarray, " n"]) -> float:
    """Return the width of a response at half its highest sample, with interpolated flanks.

    Raises
    ------
    ValueError
        The response does not fall to half on both sides.
    """
    peak = int(np.argmax(power))
    low = power < power[peak] / 2
    left, right = np.flatnonzero(low[:peak]), np.flatnonzero(low[peak:])
    if len(left) == 0 or len(right) == 0:
        raise ValueError("the response does not fall to half its peak inside the axis; widen it")
    i, j = int(left[-1]), peak + int(right[0])
    begin = np.interp(power[peak] / 2, power[i : i + 2], place[i : i + 2])
    end = np.interp(-power[peak] / 2, -power[j - 1 : j + 1], place[j - 1 : j + 1])
    return float(end - begin)


def _half_power(response: Callable[[float], float], step: float) -> float:
    """Return the first half-power point of an even response that is one at zero."""
    end = step
    while response(end) > np.sqrt(0.5):
        end += step
    return float(brentq(lambda x: response(x) - np.sqrt(0.5), end - step, end))


# Limits of the imaged angles from nadir, whatever the beam.
STEEPEST_RAD, FLATTEST_RAD = np.deg2rad(1.0), np.deg2rad(85.0)
# Length of a flown track, between so many of its poses, over the distance of its ends, at most.
TRACK_KNOTS, LONGEST_TRACK = 33, 1.05
# Pixels per half-power width of a focused point.
PIXELS_PER_WIDTH = 2
MAX_PIXELS = 10_000_000


@dataclass(frozen=True, kw_only=True)
class Strip:
    """Illuminated level ground beside a straight track.

    track: the first and the last measured pose.
    height_m: height of the ground, world frame.
    clearance_m: height of the track over it.
    incidence_rad: of the beam's middle, from nadir.
    near_m, far_m: ground range of the edges, at the half-power points of the elevation beam.
    """

    track: Pose
    side: Literal["left", "right"]
    height_m: float
    clearance_m: float
    incidence_rad: float
    near_m: float
    far_m: float

    @property
    def length_m(self) -> float:
        """Length of the track."""
        return float(np.linalg.norm((self.track.position_m[1] - self.track.position_m[0])[:2]))

    @property
    def middle_range_m(self) -> float:
        """Slant range in the middle of the beam."""
        return self.clearance_m / float(np.cos(self.incidence_rad))

    def slant_range_m(self, ground_m: float) -> float:
        """Return the slant range at a ground range."""
        return float(np.hypot(self.clearance_m, ground_m))

    def pixels(self, along_m: np.ndarray, across_m: np.ndarray, height_m: float | None = None) -> PixelGrid:
        """Return pixels by their positions along and across the track, on the ground or at a given height."""
        height = self.height_m if height_m is None else height_m
        return ground_pixels(self.track, self.side, height, along_m, across_m)


def lit_strip(
    track: Pose,
    side: Literal["left", "right"],
    clearance_m: float,
    incidence_rad: float,
    elevation_width_rad: float,
    max_range_m: float,
) -> Strip:
    """Return the ground illuminated on a side of a track, given by its first and its last measured pose.

    clearance_m, incidence_rad, elevation_width_rad: height over the ground, the beam's angle from nadir, and its
    half-power width there.
    """
    steep = max(incidence_rad - elevation_width_rad / 2, STEEPEST_RAD)
    flat = min(incidence_rad + elevation_width_rad / 2, FLATTEST_RAD, np.arccos(clearance_m / max_range_m))
    return Strip(
        track=track,
        side=side,
        height_m=float(track.position_m[:, 2].mean()) - clearance_m,
        clearance_m=clearance_m,
        incidence_rad=incidence_rad,
        near_m=clearance_m * float(np.tan(steep)),
        far_m=clearance_m * float(np.tan(flat)),
    )


def strip_along(measured: Pose, clearance_m: float, beamwidths_rad: tuple[float, float], max_range_m: float) -> Strip:
    """Return the strip of a flown track, whose poses tell side and incidence.

    Raises InputFileError for poses that are no view to the side of a straight track over the ground in range.
    """
    ends = measured.rows(np.array([0, -1]))
    east, north = (ends.position_m[1] - ends.position_m[0])[:2]
    length_m, look = float(np.hypot(east, north)), measured.boresight.mean(axis=0)
    knots = measured.position_m[np.linspace(0, len(measured) - 1, TRACK_KNOTS).astype(int), :2]
    flown_m = float(np.linalg.norm(np.diff(knots, axis=0), axis=1).sum())
    if length_m == 0 or flown_m > LONGEST_TRACK * length_m:
        message = f"the poses go {flown_m:.1f} m over a distance of {length_m:.1f} m; cut out one straight track"
        raise InputFileError(message)
    along, right = np.array([[east, north], [north, -east]]) @ look[:2] / length_m
    squint_rad = float(np.arctan2(along, abs(right)))
    if abs(squint_rad) > beamwidths_rad[0] / 2:
        message = f"the antenna looks {np.rad2deg(squint_rad):+.1f} deg ahead of the side of the track"
        raise InputFileError(message + "; only views to the side are imaged: look at measured_rotation")
    if not 0 < clearance_m < max_range_m:
        message = f"the ground is {clearance_m:.1f} m below the track; give a height between 0 and {max_range_m:.1f} m"
        raise InputFileError(message + " below it as --ground-height")
    incidence_rad = float(np.arctan2(np.hypot(along, right), -look[2]))
    side: Literal["left", "right"] = "right" if right > 0 else "left"
    strip = lit_strip(ends, side, clearance_m, incidence_rad, beamwidths_rad[1], max_range_m)
    if not strip.near_m < strip.far_m:
        message = f"the beam is {np.rad2deg(incidence_rad):.1f} deg off nadir, and meets no ground {clearance_m:.1f} m "
        raise InputFileError(message + "below within the ranges; look at measured_rotation and --ground-height")
    return strip


def focused_pixels(strip: Strip, chirp: Chirp, aperture: Aperture, window_name: str) -> PixelGrid:
    """Return pixels of full-aperture coverage, two per focused half-power width in each direction.

    Raises ScenarioError for a track shorter than the aperture, and for too many pixels.
    """
    reach = aperture.reach / float(np.sqrt(1 - aperture.reach**2))
    margin = reach * strip.slant_range_m(strip.far_m)
    if strip.length_m <= 2 * margin:
        message = (
            f"the radar transmits over {strip.length_m:.1f} m, less than the beam length of {2 * margin:.1f} m at "
            f"the far edge of the strip; raise it above {2 * margin:.1f}, or narrow the antenna's beam"
        )
        raise ScenarioError.of("platform.length_m", message)
    flattest = float(np.arctan2(strip.far_m, strip.clearance_m))
    along = azimuth_resolution_m(aperture, chirp.wavelength_m) / PIXELS_PER_WIDTH
    across = ground_range_resolution_m(chirp, window_name, flattest) / PIXELS_PER_WIDTH
    pixels = (strip.length_m - 2 * margin) / along * (strip.far_m - strip.near_m) / across
    if pixels > MAX_PIXELS:
        message = (
            f"a track of {strip.length_m:.0f} m needs {pixels:,.0f} pixels of {1e3 * along:.0f} mm x "
            f"{1e3 * across:.0f} mm, more than {MAX_PIXELS:,}; shorten it"
        )
        raise ScenarioError.of("platform.length_m", message)
    return strip.pixels(np.arange(margin, strip.length_m - margin, along), np.arange(strip.near_m, strip.far_m, across))


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
            raise ValueError("no pulses to image; add some")
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


def to_ground(
    image: SlantImage, ground_height_m: float, ground_m: Float[np.ndarray, " ground"]
) -> Float[np.ndarray, "along ground"]:
    """Return a slant-range image projected onto level ground: W, NaN nearer than it or beyond the last range.

    Parameters
    ----------
    image:
        The image.
    ground_height_m:
        Height of the ground, world frame.
    ground_m:
        Ground ranges of the columns: distances from nadir.
    """
    power = np.full((len(image.along_m), len(ground_m)), np.nan)
    for row in np.flatnonzero(np.isfinite(image.height_m)):
        slant = np.hypot(ground_m, image.height_m[row] - ground_height_m)
        power[row] = np.interp(slant, image.range_m, image.power[row], right=np.nan)
    return power
