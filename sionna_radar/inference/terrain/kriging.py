"""Kriging variance of a surface through measured heights, for cells and for means over windows.

Under a Gaussian terrain of covariance C and data y = B z + e, means over footprints with noise, the variance of what
is still unknown about a height z, or about a mean of heights, is (Rasmussen and Williams 2006, section 2.2)

    var z - k^T (B C B^T + N)^-1 k,   k = cov(B z, z).

It depends on where the echoes are and how uncertain, not on what they say. A block of cells takes it from the echoes in
and around it; those farther off add no information.

The approximate inverse of B C B^T + N preconditions conjugate gradients. By a chain of conditional distributions it is
L^T L, row i of L predicting height i from those before it, of which only the nearest matter (Vecchia 1988, "Estimation
and model identification for continuous spatial processes"). The first heights, spread over all places, are treated
exactly: they carry the long waves.

Heights are those above a plane through all echoes, whose uncertainty is included (universal kriging, Chiles and
Delfiner 2012, section 3.4). An error of the plane remains in the map by the fraction of var z that is still unknown:
next to nothing over hills, all of it over a slope that shows no hills in a short flight.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import cho_solve
from scipy.sparse import csr_matrix
from scipy.spatial import KDTree

from sionna_radar.foundation.linear_algebra import solve_lower
from sionna_radar.foundation.raster import Grid
from sionna_radar.foundation.threads import chunks, chunks_of_bytes, in_threads
from sionna_radar.inference.terrain.covariance import Covariance, FittedCovariance
from sionna_radar.inference.terrain.heights import Heights
from sionna_radar.inference.terrain.local_relief import LocalRelief

# Blocks of cells, and how far around them echoes count, at least; the nearest so many.
BLOCK_CELLS, MARGIN_M, MAX_ECHOES = 32, 20.0, 600
# Largest number of echoes for the mean over a window.
MAX_WINDOW_ECHOES = 1500
# Largest number of squares into which a window is divided.
MAX_WINDOW_SQUARES = 300
JITTER = 1e-10
# Number of heights whose covariance is inverted exactly, and of nearest heights that predict another one.
EXACT, NEAREST = 1000, 15
# Nugget, as a fraction of the variance, that keeps the covariance of nearly equal places positive definite although
# tables are interpolated; ten times as much where that is not enough.
ROUNDING = 1e-7

Places = Float[np.ndarray, "... 2"]


@dataclass(frozen=True)
class Kriging:
    """What is known of a terrain: its covariance, the heights measured, and the factor on their noise's variance.

    local: amplitude of the terrain's short waves; None where it is one.
    """

    covariance: Covariance
    heights: Heights
    noise_factor: float
    local: LocalRelief | None = None

    @property
    def terrain(self) -> FittedCovariance:
        """The covariance with the factor that goes with it."""
        return FittedCovariance(self.covariance, self.noise_factor)

    def sigma_m(self, grid: Grid, wanted: Bool[np.ndarray, "row column"]) -> Float[np.ndarray, "row column"]:
        """Return the standard deviation of the wanted cells of a grid; NaN elsewhere."""
        sigma = np.full(grid.shape, np.nan)
        blocks = [block for block in _blocks(grid) if wanted[block].any()]

        def some(low: int, high: int) -> None:
            for rows, columns in blocks[low:high]:
                here = wanted[rows, columns]
                cell = np.argwhere(here)
                place = np.column_stack([grid.x_m[columns][cell[:, 1]], grid.y_m[rows][cell[:, 0]]])
                sigma[rows, columns][here] = self._of_places(place)

        list(in_threads(some, chunks(len(blocks), 1)))
        return sigma

    def near_inverse(self) -> Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, " n"]]:
        """Return a function that nearly applies the inverse of the covariance of the measured heights."""
        count = len(self.heights)
        # Any first heights are places all over the area.
        order = np.random.default_rng(0).permutation(count)
        place_m, noise_m2 = self.heights.place_m[order], self.heights.variance_m2(self.noise_factor)[order]
        between = self._covariance(_farthest(place_m), float(np.median(self.heights.spread_m)))

        def total(member: Int[np.ndarray, "window n"]) -> Float[np.ndarray, "window n n"]:
            covariance, diagonal = between(place_m[member], place_m[member]), np.arange(member.shape[1])
            covariance[:, diagonal, diagonal] += noise_m2[member] + rounding * self.covariance.variance_m2
            return covariance

        exact, root, rounding = min(EXACT, count), None, ROUNDING
        while root is None:
            try:
                # In Fortran's order, as LAPACK solves by it.
                root = np.asfortranarray(np.linalg.cholesky(total(np.arange(exact)[None])[0]))
            except np.linalg.LinAlgError:
                if rounding > 1.0:  # so the covariance is not finite
                    raise
                rounding *= 10
        tree, done, member = KDTree(place_m[:exact]), exact, np.zeros((0, NEAREST + 1), dtype=int)
        while done < count:
            # A quarter more at once, which do not predict each other.
            new = np.arange(done, min(done + -(-done // 4), count))
            member = np.concatenate([member, np.column_stack([tree.query(place_m[new], k=NEAREST)[1], new])])
            done += len(new)
            tree = KDTree(place_m[:done])

        def some(low: int, high: int) -> Float[np.ndarray, "some member"]:
            last = np.zeros((high - low, NEAREST + 1, 1))
            last[:, -1] = 1.0
            row = np.linalg.solve(total(member[low:high]), last)[:, :, 0]
            return row / np.sqrt(np.abs(row[:, -1:]))

        bounds = chunks_of_bytes(len(member), 8 * (NEAREST + 1) ** 2)
        rows = np.concatenate([np.zeros((0, NEAREST + 1)), *in_threads(some, bounds)])
        chain = csr_matrix(
            (rows.ravel(), member.ravel(), np.arange(len(rows) + 1) * (NEAREST + 1)), shape=(len(rows), count)
        )
        back = chain.T.tocsr()

        def applied(height_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
            """Return nearly the inverse times heights."""
            ordered = height_m[order]
            solved = back @ (chain @ ordered)
            solved[:exact] += cho_solve((root, True), ordered[:exact], check_finite=False)
            result = np.empty(count)
            result[order] = solved
            return result

        return applied

    def mean_sigma_m(self, place_m: Float[np.ndarray, "cell 2"]) -> float:
        """Return the standard deviation of the mean height over some places, evenly spread over an area."""
        near, middle_m = self._near(place_m, MAX_WINDOW_ECHOES), place_m.mean(axis=0, keepdims=True)
        place_m, weight, side_m = _in_squares(place_m)
        spread = side_m / np.sqrt(12)
        before = unknown = float(weight @ self._between(place_m, place_m, spread) @ weight)
        if len(near) > 0:
            root, between = self._factored(near, place_m, spread)
            explained = solve_lower(root, between @ weight)
            unknown = max(before - float(explained @ explained), 0.0)
        return float(np.sqrt(unknown + (unknown / before) ** 2 * self._trend_m2(middle_m)[0]))

    def _of_places(self, place_m: Float[np.ndarray, "cell 2"]) -> Float[np.ndarray, " cell"]:
        before = unknown = self._before(place_m)
        near = self._near(place_m, MAX_ECHOES)
        if len(near) > 0:
            root, between = self._factored(near, place_m)
            explained = solve_lower(root, between)
            unknown = np.maximum(before - np.einsum("ij,ij->j", explained, explained), JITTER * before)
        return np.sqrt(unknown + (unknown / before) ** 2 * self._trend_m2(place_m))

    def _trend_m2(self, place_m: Float[np.ndarray, "cell 2"]) -> Float[np.ndarray, " cell"]:
        """Return the variance of the trend at places."""
        middle_m, covariance = self._trend
        design = np.column_stack([np.ones(len(place_m)), place_m - middle_m])
        return np.einsum("ni,ij,nj->n", design, covariance, design)

    @cached_property
    def _trend(self) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "3 3"]]:
        """Return the middle of the heights, and the covariance of the trend's height there and of its slopes."""
        middle_m = self.heights.place_m.mean(axis=0)
        design = np.column_stack([np.ones(len(self.heights)), self.heights.place_m - middle_m])
        # The trend is that of mean ranges, also where whole echoes tell more of the terrain than these.
        variance_m2 = self.heights.variance_m2(max(self.noise_factor, 1.0))
        return middle_m, np.linalg.pinv(design.T / variance_m2 @ design)

    def _near(self, place_m: Float[np.ndarray, "cell 2"], most: int) -> Int[np.ndarray, " near"]:
        """Return the heights in and around some places, the nearest of them."""
        low, high = place_m.min(axis=0), place_m.max(axis=0)
        outside = np.maximum(low - self.heights.place_m, self.heights.place_m - high).max(axis=1)
        near = np.flatnonzero(outside < MARGIN_M)
        return near if len(near) <= most else near[np.argpartition(outside[near], most)[:most]]

    def _factored(
        self, near: Int[np.ndarray, " near"], place_m: Float[np.ndarray, "cell 2"], around_m: float = 0.0
    ) -> tuple[Float[np.ndarray, "near near"], Float[np.ndarray, "near cell"]]:
        """Return the Cholesky factor of the measured heights' covariance, and theirs with the heights of places.

        around_m: standard deviation, along each axis, of what is averaged around each place.
        """
        heights = self.heights.rows(near)
        spread = float(np.median(heights.spread_m))
        total = self._between(heights.place_m, heights.place_m, spread)
        noise = heights.variance_m2(self.noise_factor)
        total[np.diag_indices_from(total)] += noise + JITTER * self.covariance.variance_m2
        between = self._between(heights.place_m, place_m, float(np.hypot(spread, around_m)) / np.sqrt(2))
        return np.linalg.cholesky(total), between

    def _before(self, place_m: Float[np.ndarray, "cell 2"]) -> Float[np.ndarray, " cell"]:
        """Return the variance of heights before anything is measured."""
        if self.local is None:
            return np.full(len(place_m), self.covariance.variance_m2 + self.covariance.microrelief.variance_m2)
        long, short = (table.value_m2[0] for table in self.local.divided(self.covariance, 1.0, 0.0))
        return long + self.local.at(place_m) ** 2 * short

    def _between(
        self, one_m: Float[np.ndarray, "n 2"], other_m: Float[np.ndarray, "m 2"], spread_m: float
    ) -> Float[np.ndarray, "n m"]:
        """Return the covariance of heights between places, both averaged over a Gaussian of the spread."""
        return self._covariance(_farthest(np.concatenate([one_m, other_m])), spread_m)(one_m, other_m)

    def _covariance(self, farthest_m: float, spread_m: float) -> Callable[[Places, Places], Float[np.ndarray, "..."]]:
        """Return the function of that covariance, up to a distance; of places, or of windows of places."""
        if self.local is None:
            return self.covariance.table(farthest_m, spread_m).between
        local, (long, short) = self.local, self.local.divided(self.covariance, farthest_m, spread_m)

        def between(one_m: Places, other_m: Places) -> Float[np.ndarray, "..."]:
            amplitude = local.at(one_m)[..., :, None] * local.at(other_m)[..., None, :]
            return long.between(one_m, other_m) + amplitude * short.between(one_m, other_m)

        return between


def _farthest(place_m: Float[np.ndarray, "n 2"]) -> float:
    """Return a distance that any two places are nearer than, m."""
    return float(np.hypot(*np.ptp(place_m, axis=0))) + 1.0


def _in_squares(
    place_m: Float[np.ndarray, "cell 2"],
) -> tuple[Float[np.ndarray, "square 2"], Float[np.ndarray, " square"], float]:
    """Return the middles of squares that places lie in, the share of each, and their side; few places as they are."""
    if len(place_m) <= MAX_WINDOW_SQUARES:
        return place_m, np.full(len(place_m), 1 / len(place_m)), 0.0
    low, extent = place_m.min(axis=0), np.ptp(place_m, axis=0)
    side = float(np.sqrt(extent.prod() / MAX_WINDOW_SQUARES))
    square = np.floor((place_m - low) / side)
    _, square_of, count = np.unique(square, axis=0, return_inverse=True, return_counts=True)
    middle = np.stack([np.bincount(square_of, column) for column in place_m.T], axis=1) / count[:, None]
    return middle, count / len(place_m), side


def _blocks(grid: Grid) -> Iterator[tuple[slice, slice]]:
    for row in range(0, grid.rows, BLOCK_CELLS):
        for column in range(0, grid.columns, BLOCK_CELLS):
            yield slice(row, row + BLOCK_CELLS), slice(column, column + BLOCK_CELLS)
