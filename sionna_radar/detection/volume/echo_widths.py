"""How long the ground's echo is behind a volume: the probability of its widths, from the slopes that the beam meets."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import gaussian_filter1d

from sionna_radar.detection.ranging.plane_fit import BeamProfile
from sionna_radar.detection.volume.ground import DEVIATE_WEIGHTS, DEVIATES, SLOPES, slopes_of
from sionna_radar.detection.volume.shapes import FINE, beam_sigma
from sionna_radar.flight.frames import MIN_GRAZING_SINE

# Minimum effective slope: the beam is as wide across the plane of incidence, and ground is curved.
MIN_SLOPE = 0.15
# Slopes of a smaller probability are left out.
MIN_SLOPE_WEIGHT = 1e-3


@dataclass(frozen=True, eq=False)
class EchoWidths:
    """The prior of the widths of echoes.

    beam: in the plane of incidence. widths: standard deviations of the echoes compared, in cells, in equal ratios.
    spread_nepers: uncertainty of an echo's width on ground of a known slope. cells: number of range cells.
    """

    beam: BeamProfile
    widths: Float[np.ndarray, " width"]
    spread_nepers: float
    cells: int

    def of(
        self,
        down: Float[np.ndarray, " pulse"],
        range_cells: Float[np.ndarray, "pulse column"],
        slope_weight: Float[np.ndarray, "kind slope"],
        tilt: float = 0.0,
    ) -> Float32[np.ndarray, "kind pulse column width"]:
        """Return the probability of each width at ranges of the ground, in cells.

        down: cosine of the boresight's angle from nadir. slope_weight: probability of each of `SLOPES`, of kinds of
        ground. tilt: angle by which the ground rises away from the radar on average.
        """
        near, far, fraction = self.up_to(down, range_cells, slope_weight, tilt)
        # The outermost widths stand for all beyond them.
        out = np.ones((*near.shape[:-1], len(self.widths)), dtype=np.float32)
        out[..., :-1] = near + fraction[..., None] * (far - near)
        out[..., 1:] -= out[..., :-1].copy()
        return out

    def up_to(
        self,
        down: Float[np.ndarray, " pulse"],
        range_cells: Float[np.ndarray, "pulse column"],
        slope_weight: Float[np.ndarray, "kind slope"],
        tilt: float,
    ) -> tuple[
        Float32[np.ndarray, "kind pulse column less"],
        Float32[np.ndarray, "kind pulse column less"],
        Float32[np.ndarray, "pulse column"],
    ]:
        """Return the probability of each width but the last, or a lesser one, at two places, and the way between them.

        Arguments as of `of`.
        """
        narrower = self._narrower(down, slope_weight, tilt)
        place = FINE / self._step_nepers * np.log(self.cells / range_cells)
        below = place.astype(np.int64)
        # One width after another, from each of the `FINE` places between two.
        by_phase = np.ascontiguousarray(np.swapaxes(narrower.reshape(*narrower.shape[:2], -1, FINE), 2, 3))
        of_widths, row = sliding_window_view(by_phase, len(self.widths) - 1, axis=3), np.arange(len(place))[:, None]
        near, far = (of_widths[:, row, at % FINE, at // FINE] for at in (below, below + 1))
        return near, far, (place - below).astype(np.float32)

    def _narrower(
        self, down: Float[np.ndarray, " pulse"], slope_weight: Float[np.ndarray, "kind slope"], tilt: float
    ) -> Float32[np.ndarray, "kind pulse place"]:
        """Return the probability that an echo counts as one of some width over its range, or as a narrower one.

        The first place is that of the narrowest echo at the farthest range; there are `FINE` of them from one of
        `widths` to the next. An echo between two of those counts as both, as the nearer one the more.
        """
        places = FINE * (len(self.widths) + int(np.ceil(np.log(self.cells) / self._step_nepers)) + 1)
        per_neper = FINE / self._step_nepers
        spread = per_neper * max(self.spread_nepers, 1e-3)
        slope_weight = np.where(slope_weight >= MIN_SLOPE_WEIGHT, slope_weight, 0.0)
        likely = slope_weight.any(axis=0)
        incidence = np.arccos(np.clip(down, MIN_GRAZING_SINE, 1.0))[:, None] - tilt
        on_slope = incidence - slopes_of(SLOPES[likely, None, None])
        # The axis meets slopes in proportion to the area that they turn towards the radar.
        turned = DEVIATE_WEIGHTS * np.maximum(np.cos(on_slope), 1e-9)
        turned /= turned.sum(axis=2, keepdims=True)
        tangent = np.hypot(np.tan(np.clip(on_slope, -1.5, 1.5)), MIN_SLOPE)
        at = per_neper * np.log(beam_sigma(self.beam) * tangent * self.cells / self.widths[0])
        # Each is shared by the two places beside it: from there all spread alike.
        reach = int(np.ceil(4 * spread))
        count = places + 2 * reach
        share, below = np.modf(np.clip(at + reach, 0.0, count - 1.001))
        rows = np.arange(turned.size // len(DEVIATES)).reshape(*turned.shape[:2], 1)
        first = (count * rows + below.astype(np.int64)).ravel()
        lie = np.bincount(first, (turned * (1 - share)).ravel(), count * rows.size)
        lie += np.bincount(first + 1, (turned * share).ravel(), len(lie))
        less = np.cumsum(lie.reshape(*turned.shape[:2], count), axis=2)
        less = np.tensordot(slope_weight[:, likely] / slope_weight.sum(axis=1, keepdims=True), less, 1)
        less = gaussian_filter1d(less, spread, mode="nearest")[..., reach:-reach]
        return sliding_window_view(less[..., :-1], FINE, axis=-1).mean(axis=-1).astype(np.float32)

    @property
    def _step_nepers(self) -> float:
        """Step from one of `widths` to the next."""
        return float(np.log(self.widths[1] / self.widths[0]))
