"""Whether two pairs of maps differ by more than speckle: a randomisation test over tiles."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.stats import f

from sionna_radar.foundation.raster import Raster

DRAWS = 20_000
# Width of a tile in correlation lengths.
TILE_LENGTHS = 3
# A tile with fewer cells is a corner of the map, and is dropped.
MIN_CELLS = 4


@dataclass(frozen=True, kw_only=True)
class SpeckleTest:
    """Result of the randomisation test.

    cross_rms_m: RMS difference of one engine's DEM and the other's, over all four cross pairs.
    speckle_rms_m: the same expected from speckle alone: over the two pairs of one engine.
    tiles: their number n; the smallest possible probability is 3^-n.
    probability: of a difference this large from speckle alone; NaN without tiles.
    gaussian_probability: the same of Gaussian errors, one independent one in each tile; for few tiles.
    """

    cross_rms_m: float
    speckle_rms_m: float
    tiles: int
    probability: float
    gaussian_probability: float

    def can_reject(self, probability: float) -> bool:
        """Return True if the number of tiles allows so small a probability."""
        return 3.0**-self.tiles <= probability


def compare_speckle(one: tuple[Raster, Raster], other: tuple[Raster, Raster], correlation_m: float) -> SpeckleTest:
    """Test two engines' pairs of DEMs.

    one, other: DEMs from two seeds of each engine, all on one grid.
    correlation_m: distance over which errors of the DEM are correlated: the footprint, or the gap between echoes.
    """
    grid = one[0].grid
    height = np.stack([dem.height_m.ravel() for dem in (*one, *other)])
    common = np.flatnonzero(np.isfinite(height).all(axis=0))
    height = height[:, common]
    if len(common) == 0:
        return SpeckleTest(
            cross_rms_m=np.nan, speckle_rms_m=np.nan, tiles=0, probability=np.nan, gaussian_probability=np.nan
        )
    row, column = np.divmod(common, grid.columns)
    side = max(1, round(TILE_LENGTHS * correlation_m / grid.spacing_m))
    _, tile = np.unique(np.stack([row // side, column // side]), axis=1, return_inverse=True)
    tile = tile.ravel()
    usable = np.bincount(tile) >= MIN_CELLS
    # The true pairing first, then the two others.
    pairings = (((0, 1), (2, 3)), ((0, 2), (1, 3)), ((0, 3), (1, 2)))
    distance = np.stack(
        [np.bincount(tile, (height[[*a]].mean(axis=0) - height[[*b]].mean(axis=0)) ** 2)[usable] for a, b in pairings]
    )
    tiles, (true, *others) = int(usable.sum()), distance.sum(axis=1)
    # The three differences of means are uncorrelated, and equally large by speckle alone.
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = true / np.mean(others)
    return SpeckleTest(
        cross_rms_m=_rms(height, ((0, 2), (0, 3), (1, 2), (1, 3))),
        speckle_rms_m=_rms(height, ((0, 1), (2, 3))),
        tiles=tiles,
        probability=_chance(distance / np.maximum(distance.sum(axis=0), np.finfo(float).tiny)),
        gaussian_probability=float(f.sf(ratio, tiles, 2 * tiles)),
    )


def _rms(height: Float[np.ndarray, "4 cell"], pairs: tuple[tuple[int, int], ...]) -> float:
    return float(np.sqrt(np.mean([(height[a] - height[b]) ** 2 for a, b in pairs])))


def _chance(fraction: Float[np.ndarray, "3 tile"]) -> float:
    """Return the share of random pairings that reach the sum of the first pairing."""
    tiles = fraction.shape[1]
    if tiles == 0:
        return float("nan")
    random = np.random.default_rng(1937)
    true_sum = fraction[0].sum()
    reached = 0
    for _ in range(0, DRAWS, 1000):
        choice = random.integers(0, 3, (1000, tiles))
        total = fraction[choice, np.arange(tiles)].sum(axis=1)
        reached += int(np.sum(total >= true_sum * (1 - 1e-12)))
    # The true pairing is one of those that could have been drawn.
    return (reached + 1) / (DRAWS + 1)
