"""The strip of ground that a side-looking radar images beside a straight track, and suitable pixels."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.imaging.aperture import Aperture
from sionna_radar.imaging.grid import PixelGrid, ground_pixels
from sionna_radar.imaging.resolution import azimuth_resolution_m, ground_range_resolution_m
from sionna_radar.radar.chirp import Chirp

# Angles from nadir between which level ground is imaged, whatever the beam.
STEEPEST_RAD, FLATTEST_RAD = np.deg2rad(1.0), np.deg2rad(85.0)
# Pixels per half-power width of a focused point.
PIXELS_PER_WIDTH = 2
MOST_PIXELS = 10_000_000


@dataclass(frozen=True, kw_only=True)
class Strip:
    """Level ground beside a straight track, as far across as the beam illuminates it.

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
    """Return the strip that a beam illuminates.

    Parameters
    ----------
    track:
        The first and the last measured pose.
    side:
        The side that the antenna looks to.
    clearance_m:
        Height of the track over the ground.
    incidence_rad, elevation_width_rad:
        The beam's angle from nadir, and its half-power width there.
    max_range_m:
        The unambiguous slant range of the sampling.

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


def focused_pixels(strip: Strip, chirp: Chirp, aperture: Aperture, window_name: str) -> PixelGrid:
    """Return pixels wherever the full aperture is flown, so fine that a focused point covers two each way.

    Raises
    ------
    ScenarioError
        The track is shorter than the aperture, or needs too many pixels.

    """
    reach = aperture.reach / float(np.sqrt(1 - aperture.reach**2))
    margin = reach * strip.slant_range_m(strip.far_m)
    if strip.length_m <= 2 * margin:
        message = (
            f"the radar transmits over {strip.length_m:.1f} m, less than the beam length of {2 * margin:.1f} m at "
            f"the far edge of the strip; raise it above {2 * margin:.1f}, or narrow the antenna's beam"
        )
        raise ScenarioError([Problem("platform.length_m", message)])
    flattest = float(np.arctan2(strip.far_m, strip.clearance_m))
    along = azimuth_resolution_m(aperture, chirp.wavelength_m) / PIXELS_PER_WIDTH
    across = ground_range_resolution_m(chirp, window_name, flattest) / PIXELS_PER_WIDTH
    pixels = (strip.length_m - 2 * margin) / along * (strip.far_m - strip.near_m) / across
    if pixels > MOST_PIXELS:
        message = (
            f"a track of {strip.length_m:.0f} m needs {pixels:,.0f} pixels of {1e3 * along:.0f} mm x "
            f"{1e3 * across:.0f} mm, more than {MOST_PIXELS:,}; shorten it"
        )
        raise ScenarioError([Problem("platform.length_m", message)])
    return strip.pixels(np.arange(margin, strip.length_m - margin, along), np.arange(strip.near_m, strip.far_m, across))
