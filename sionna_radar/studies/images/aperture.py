"""The synthetic aperture (the pulses focused into a pixel, and their weights), and the pixels of an image.

The pixels are a parallelogram of points on a plane, usually the level ground beside the track.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.signal import get_window

from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.radar.antenna import FOLDING, Antenna, Cut, lobe_samples
from sionna_radar.radar.chirp import Chirp

WINDOW_NODES = 1024


@dataclass(frozen=True, kw_only=True)
class Aperture:
    """The focused part of the azimuth beam, and its weighting.

    width_rad: full angle about boresight in the plane of the azimuth cut.
    azimuth: the antenna's azimuth cut.
    weighting: "beam" keeps the weight of the two-way beam (best signal-to-noise ratio, to within a few tenths of a
        decibel); "flat" divides it out (finest resolution for the width).
    window: an additional taper across the width, any of `scipy.signal.get_window`; lowers side lobes.
    """

    width_rad: float
    azimuth: Cut
    weighting: Literal["beam", "flat"] = "beam"
    window: str = "boxcar"

    @property
    def reach(self) -> float:
        """Largest focused direction cosine along the antenna's left."""
        return float(np.sin(self.width_rad / 2))

    @cached_property
    def taper(self) -> Float[np.ndarray, " node"]:
        """Samples of the window at equal steps of the direction cosine, from -reach to reach."""
        return get_window(self.window, WINDOW_NODES, fftbins=False)

    def two_way(self, u: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the two-way voltage pattern relative to its peak at direction cosines."""
        return self.azimuth.at(u) ** 2

    def weight(self, u: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the weights of pulses with the pixel at direction cosines within the reach."""
        taper = np.interp(u, np.linspace(-self.reach, self.reach, WINDOW_NODES), self.taper)
        return taper / self.two_way(u) if self.weighting == "flat" else taper

    @cached_property
    def beam_reach(self) -> float:
        """Direction cosine beyond which main-lobe echoes are too weak to alias into the focused part."""
        edge = lobe_samples(self.azimuth, FOLDING).stop
        return float(self.azimuth.cosine[edge]) if edge < len(self.azimuth.cosine) else 1.0


def whole_beam(antenna: Antenna) -> Aperture:
    """Return the aperture of an antenna's whole main lobe, with beam weighting."""
    aperture = Aperture(width_rad=1.0, azimuth=antenna.azimuth)
    return Aperture(width_rad=2 * float(np.arcsin(aperture.beam_reach)), azimuth=antenna.azimuth)


def check_sampling(measured: Pose, chirp: Chirp, aperture: Aperture, rate_hz: float | None = None) -> None:
    """Raise ScenarioError for a rate of chirps, None without a pause, below the azimuth Nyquist rate.

    Pulses a distance d apart cannot distinguish the direction cosine u from u + lambda / (2 d). The illuminated part
    |u| <= beam_reach must not alias into the focused part |u| <= reach: d <= lambda / (2 (reach + beam_reach)).
    """
    left = measured.R_world_antenna[:, :, 1]
    speed = float(np.abs(np.einsum("pi,pi->p", measured.velocity_mps, left)).max(initial=0.0))
    needed_hz = 2 * speed * (aperture.reach + aperture.beam_reach) / chirp.wavelength_m
    rate_hz = rate_hz or chirp.rate_hz
    if rate_hz < needed_hz * (1 - 1e-9):
        message = (
            f"{rate_hz:g} puts the pulses {1e3 * speed / rate_hz:.3g} mm apart at {speed:.3g} m/s, too far "
            f"for the phase along the track; raise it to {np.ceil(needed_hz):.0f}, lower platform.speed_mps, or narrow "
            f"the focused {np.rad2deg(aperture.width_rad):.3g} deg"
        )
        raise ScenarioError.of("radar.chirp_rate_hz", message)


@dataclass(frozen=True, kw_only=True)
class PixelGrid:
    """Pixels by their positions along and across the track.

    origin_m: origin of both axes, world frame.
    along, across: unit vectors of the axes.
    along_m, across_m: positions of the columns and of the rows.
    """

    origin_m: Float[np.ndarray, " 3"]
    along: Float[np.ndarray, " 3"]
    across: Float[np.ndarray, " 3"]
    along_m: Float[np.ndarray, " column"]
    across_m: Float[np.ndarray, " row"]

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return len(self.across_m), len(self.along_m)

    @property
    def position_m(self) -> Float[np.ndarray, "row column 3"]:
        """Pixel centres, world frame."""
        return self.origin_m + self.across_m[:, None, None] * self.across + self.along_m[None, :, None] * self.along


def ground_pixels(
    pose: Pose,
    side: Literal["left", "right"],
    height_m: float,
    along_m: Float[np.ndarray, " column"],
    across_m: Float[np.ndarray, " row"],
) -> PixelGrid:
    """Return pixels on level ground beside a straight track.

    Parameters
    ----------
    pose:
        Poses along the track; the first and the last give its direction.
    side:
        Look side of the antenna.
    height_m:
        Height of the ground, world frame.
    along_m, across_m:
        Positions along the track from below the first pose, and ground ranges from the track.
    """
    start, end = pose.position_m[0, :2], pose.position_m[-1, :2]
    along = (end - start) / np.linalg.norm(end - start)
    turn = 1.0 if side == "right" else -1.0
    return PixelGrid(
        origin_m=np.array([*start, height_m]),
        along=np.array([*along, 0.0]),
        across=turn * np.array([along[1], -along[0], 0.0]),
        along_m=along_m,
        across_m=across_m,
    )
