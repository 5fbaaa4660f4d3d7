"""Plants in rows: single plants of random height, walls of leaves or rounded crowns, with gaps where one is missing."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri

from sionna_radar.foundation.randomness import Stream, place_uniforms

# Standard deviations of the height from plant to plant that none exceeds.
MAX_HEIGHT_SIGMAS = 2.5
# Shift of the rows that no cell's centre lies at the edge of one, m.
TIE_M = 1e-6


@dataclass(frozen=True, kw_only=True)
class Planting:
    """Plants in rows, counted from the local origin.

    height_m, base_height_m: of the tops and of the lowest leaves above the ground.
    row_spacing_m, plant_spacing_m: between rows, and between the plants of one.
    row_width_m, row_heading_rad: of the foliage across its row; of the rows, clockwise from north.
    missing: share of the plants that are missing.
    height_spread: standard deviation of the heights of plants, over the height.
    crowned: whether each plant has a crown, a spheroid as wide as the row, and is no part of a wall of leaves.
    seed, number: of the scenario, and of the stand in it; they draw the plants.
    """

    height_m: float
    base_height_m: float
    row_spacing_m: float
    row_width_m: float
    row_heading_rad: float
    plant_spacing_m: float
    missing: float
    height_spread: float
    crowned: bool
    seed: int
    number: int

    @property
    def finest_m(self) -> float:
        """The smallest of the lengths that cells should resolve: rows, gaps between them, and missing plants."""
        gap_m = self.row_spacing_m - self.row_width_m
        lengths = [self.row_width_m, gap_m] if gap_m > 0 else [np.inf]
        return min(*lengths, self.plant_spacing_m if self.missing or self.crowned else np.inf)

    @property
    def foliage_depth_m(self) -> float:
        """Volume of the foliage over the area of the field, none of its plants missing."""
        depth_m = (self.height_m - self.base_height_m) * self.row_width_m / self.row_spacing_m
        if not self.crowned:
            return depth_m
        # Of a spheroid, less what neighbours that stand closer than its width cut off.
        apart = self.plant_spacing_m / self.row_width_m
        return depth_m * np.pi / 6 / apart * (1.0 if apart >= 1 else (3 * apart - apart**3) / 2)

    def foliage_m(self, place_m: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "2 n"]:
        """Return the heights above ground between which there are leaves over some places; NaN where there are none."""
        sine, cosine = np.sin(self.row_heading_rad), np.cos(self.row_heading_rad)
        # A cell whose centre is on the edge of a row belongs to one side of it.
        along_m, across_m = np.array([[sine, cosine], [cosine, -sine]]) @ place_m.T + TIE_M
        row, plant = np.round(across_m / self.row_spacing_m), np.round(along_m / self.plant_spacing_m)
        identity = np.column_stack([row, plant, np.full(len(place_m), float(self.number))])
        drawn = place_uniforms(self.seed, Stream.CROPS, identity, 2)
        off = 2 * np.abs(across_m - row * self.row_spacing_m) / self.row_width_m
        sigmas = np.clip(ndtri(np.maximum(drawn[:, 1], 1e-12)), -MAX_HEIGHT_SIGMAS, MAX_HEIGHT_SIGMAS)
        depth_m = (self.height_m - self.base_height_m) * np.maximum(1 + self.height_spread * sigmas, 0.0)
        low_m, high_m = np.full(len(place_m), self.base_height_m), self.base_height_m + depth_m
        if self.crowned:
            off = np.hypot(off, 2 * (along_m - plant * self.plant_spacing_m) / self.row_width_m)
            cut_m = depth_m / 2 * (1 - np.sqrt(np.maximum(1 - off**2, 0.0)))
            low_m, high_m = low_m + cut_m, high_m - cut_m
        stands = (off <= 1) & (drawn[:, 0] >= self.missing) & (high_m > low_m)
        return np.where(stands, np.stack([low_m, high_m]), np.nan)
