"""Directions along the cones of range rates, scanned for sources and fitted to the channels of a cell."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float, Int

from sionna_radar.detection.angle.frame_map import FrameMap
from sionna_radar.detection.angle.row import outside, separators
from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.columns import Columns
from sionna_radar.radar.mimo_array import MimoArray

# Directions in a spectrum per beam of the virtual array.
STEPS_IN_BEAM = 4
# Steps of a parabola to a source's place, each half as wide.
ASCENTS = 3
# Least fraction of a source's steering vector orthogonal to that of another source: a quarter of a beam.
MIN_SEPARATION = 0.05
# Error of the phases of scanned directions by a range that many cells share, rad; found ones are refined at their own.
CURVATURE_RAD = 0.3


@dataclass(frozen=True, kw_only=True)
class Cones(Columns):
    """Directions of range rates, in the antenna's frame: u = axis + across cos(phi) + up sin(phi).

    row: of the map that a range rate folds into; fold: how many times it does.
    axis_per_rate: derivative of the axis by the range rate, s/m; zero without a motion.
    """

    row: Int[np.ndarray, " cone"]
    fold: Int[np.ndarray, " cone"]
    range_rate_mps: Float[np.ndarray, " cone"]
    axis: Float[np.ndarray, "cone 3"]
    axis_per_rate: Float[np.ndarray, "cone 3"]
    across: Float[np.ndarray, "cone 3"]
    up: Float[np.ndarray, "cone 3"]

    @classmethod
    def of(cls, frame: FrameMap, span_mps: float, measured: Pose) -> "Cones":
        """Return the cones of all range rates of a map, `span_mps` apart where they fold; none without motion.

        Where the motion is not known the scatterers may have any of their own, and all lie in the plane of boresight
        and left.
        """
        velocity = measured.R_world_antenna[0].T @ measured.velocity_mps[0]
        if np.isnan(velocity).any():
            rows = np.arange(len(frame.rate_mps))
            ahead, left, _ = (np.tile(axis, (len(rows), 1)) for axis in np.eye(3))
            axis = np.zeros((len(rows), 3))
            return cls(
                row=rows,
                fold=0 * rows,
                range_rate_mps=frame.rate_mps,
                axis=axis,
                axis_per_rate=axis,
                across=left,
                up=ahead,
            )
        speed = float(np.linalg.norm(velocity))
        most = int(np.ceil(speed / span_mps)) + 1 if speed > 0 else 0
        row, fold = (
            g.ravel() for g in np.meshgrid(np.arange(len(frame.rate_mps)), np.arange(-most, most + 1), indexing="ij")
        )
        rate = frame.rate_mps[row] + fold * span_mps
        seen = np.abs(rate) < speed
        row, fold, rate = row[seen], fold[seen], rate[seen]
        ahead = velocity / max(speed, 1e-300)
        # Up: next to the boresight, so that phi = 90 deg is the direction nearest to it.
        up = np.array([1.0, 0.0, 0.0]) - ahead[0] * ahead
        if np.linalg.norm(up) < 1e-6:
            up = np.array([0.0, 0.0, 1.0]) - ahead[2] * ahead
        up /= max(float(np.linalg.norm(up)), 1e-300)
        cosine = -rate / max(speed, 1e-300)
        sine = np.sqrt(1 - cosine**2)
        return cls(
            row=row,
            fold=fold,
            range_rate_mps=rate,
            axis=np.outer(cosine, ahead),
            axis_per_rate=np.tile(-ahead / max(speed, 1e-300), (len(rate), 1)),
            across=np.outer(sine, np.cross(up, ahead)),
            up=np.outer(sine, up),
        )

    def at(self, where: "Angles", faster_mps: Float[np.ndarray, " n"] | None = None) -> Float[np.ndarray, "n 3"]:
        """Return unit vectors; faster_mps: range rates less those of the cones, zero by default."""
        phi, cone = where.phi_rad[:, None], where.cone
        axis, around = self.axis[cone], np.cos(phi) * self.across[cone] + np.sin(phi) * self.up[cone]
        if faster_mps is None:
            return axis + around
        axis = axis + faster_mps[:, None] * self.axis_per_rate[cone]
        longer = np.sqrt(np.maximum(1 - np.sum(axis**2, axis=1), 0.0)) / np.linalg.norm(around, axis=1)
        return axis + around * longer[:, None]


@dataclass(frozen=True)
class Angles(Columns):
    """Directions on cones: the angle about the motion, and the number of the cone."""

    phi_rad: Float[np.ndarray, " n"]
    cone: Int[np.ndarray, " n"]


@dataclass(frozen=True, kw_only=True)
class Cells(Columns):
    """Cells of a map and their channels.

    range_m: interpolated between the cells. faster_mps: interpolated range rate less that of the row.
    """

    rate: Int[np.ndarray, " cell"]
    cell: Int[np.ndarray, " cell"]
    range_m: Float[np.ndarray, " cell"]
    faster_mps: Float[np.ndarray, " cell"]
    x: Complex[np.ndarray, "cell channel"]


class ConeScan:
    """Directions in cells of a map, along the cones of their range rates."""

    def __init__(self, array: MimoArray, cones: Cones, half_view_rad: float, down: Float[np.ndarray, "3"]) -> None:
        self.array, self.cones, self._down = array, cones, down
        size = max(float(array.size_m.max()) / array.wavelength_m, 1.0)
        self._step, self._least_ahead = 1 / (size * STEPS_IN_BEAM), np.cos(half_view_rad)
        elements = (array.transmitter_m, array.receiver_m)
        square = max(float(np.sum(e**2, axis=1).max()) for e in elements)
        self._bend_m = np.pi * square / array.wavelength_m / CURVATURE_RAD

    def strongest(self, cells: Cells) -> tuple[Float[np.ndarray, " cell"], Angles, Int[np.ndarray, " cell"]]:
        """Return the power of the strongest scanned direction of each cell, where it is, and of how many."""
        count = len(cells)
        level, directions = np.zeros(count), np.zeros(count, dtype=np.int64)
        phi, cone = np.zeros(count), np.zeros(count, dtype=np.int64)
        for members, grid, power in self._scanned(cells):
            best = np.argmax(power, axis=1)
            level[members] = power[np.arange(len(members)), best]
            phi[members], cone[members], directions[members] = grid.phi_rad[best], grid.cone[best], len(grid)
        return level, Angles(phi, cone), directions

    def _scanned(self, cells: Cells) -> Iterator[tuple[Int[np.ndarray, " own"], Angles, Float[np.ndarray, "own n"]]]:
        """Yield the cells of each range rate whose wavefronts are bent alike, the directions, and the spectra."""
        bend = np.floor(self._bend_m / np.maximum(cells.range_m, 1e-3)).astype(np.int64)
        order = np.lexsort((bend, cells.rate))
        changes = (np.diff(cells.rate[order]) != 0) | (np.diff(bend[order]) != 0)
        grids: dict[int, Angles] = {}
        for members in np.split(order, np.flatnonzero(changes) + 1):
            if not len(members):
                continue
            row = int(cells.rate[members[0]])
            if row not in grids:
                grids[row] = self._grid(row)
            if not len(grids[row]):
                continue
            middle_m = float(1 / np.mean(1 / np.maximum(cells.range_m[members], 1e-3)))
            grid = grids[row]
            sent, got = self.array.responses(self.cones.at(grid), self.cones.range_rate_mps[grid.cone], middle_m)
            # Receivers first: the vectors of all channels are never made.
            by_chirp = cells.x[members].reshape(len(members), sent.shape[1], got.shape[1]) @ got.conj().T
            spectrum = np.einsum("ncg,gc->ng", by_chirp, sent.conj())
            yield members, grid, np.abs(spectrum) ** 2 / self.array.gain**2

    def _grid(self, row: int) -> Angles:
        """Return the scanned directions of a range rate: along all its cones, as far as the view reaches."""
        phi, cones = np.arange(0.0, np.pi, self._step), np.flatnonzero(self.cones.row == row)
        grid = Angles(np.tile(phi, len(cones)), np.repeat(cones, len(phi)))
        return grid.rows(np.flatnonzero(self.cones.at(grid)[:, 0] >= self._least_ahead))

    def vectors(self, where: Angles, cells: Cells) -> Complex[np.ndarray, "n channel"]:
        """Return steering vectors of directions, one in each cell."""
        rate_mps = self.cones.range_rate_mps[where.cone] + cells.faster_mps
        return self.array.steering(self.cones.at(where, cells.faster_mps), rate_mps, cells.range_m)

    def refined(self, cells: Cells, where: Angles, beside: Angles | None = None) -> Angles:
        """Return the direction near one at which a source, alone or beside another, explains most of each cell."""
        step, phi = self._step, where.phi_rad
        other = None if beside is None else self.vectors(beside, cells)
        for _ in range(ASCENTS):
            left, centre, right = (
                self._explained(cells, Angles(phi + side * step, where.cone), other) for side in (-1, 0, 1)
            )
            bend = left - 2 * centre + right
            peaked = np.clip((left - right) / np.where(bend < 0, 2 * bend, 1.0), -1.0, 1.0)
            phi = phi + step * np.where(bend < 0, peaked, np.sign(right - left))
            step = step / 2
        return Angles(phi, where.cone)

    def _explained(
        self, cells: Cells, where: Angles, other: Complex[np.ndarray, "cell channel"] | None
    ) -> Float[np.ndarray, " cell"]:
        a = self.vectors(where, cells)
        if other is not None:
            shared = np.einsum("nc,nc->n", other.conj(), a) / self.array.gain
            a = a - shared[:, None] * other
        left = np.maximum(np.sum(np.abs(a) ** 2, axis=1), MIN_SEPARATION * self.array.gain)
        return np.abs(np.einsum("nc,nc->n", a.conj(), cells.x)) ** 2 / left

    def fitted(self, cells: Cells, where: Angles) -> Complex[np.ndarray, "cell channel"]:
        """Return the part of the channels that one source explains."""
        a = self.vectors(where, cells)
        amplitude = np.einsum("nc,nc->n", a.conj(), cells.x) / self.array.gain
        return amplitude[:, None] * a

    def lead(self, cells: Cells, sources: tuple[Angles, ...], cell_m: float) -> Float[np.ndarray, "cell source"]:
        """Return the excess of the sources' power over that of any direction away from them, or on another cone.

        Away is farther than a beam, and than two range cells of `cell_m` of level ground are long.
        """
        beam = STEPS_IN_BEAM * self._step
        near = [beam + self._long_rad(where, cells.range_m, 2 * cell_m) for where in sources]
        away = np.zeros(len(cells))
        for members, grid, power in self._scanned(cells):
            for where, reach in zip(sources, near, strict=True):
                close = np.abs(grid.phi_rad - where.phi_rad[members, None]) <= reach[members, None]
                power[close & (grid.cone == where.cone[members, None])] = 0.0
            away[members] = power.max(axis=1)
        return np.column_stack(
            [np.sum(np.abs(self.fitted(cells, where)) ** 2, axis=1) / self.array.gain - away for where in sources]
        )

    def _long_rad(
        self, where: Angles, range_m: Float[np.ndarray, " cell"], length_m: float
    ) -> Float[np.ndarray, " cell"]:
        """Return the angle about the motion over which the range to level ground grows by a length."""
        step = 0.01 * self._step
        height, height_after = (
            self.cones.at(Angles(where.phi_rad + by, where.cone)) @ self._down for by in (0.0, step)
        )
        slope = np.abs(height_after - height) / step / np.maximum(height, 1e-3)
        return np.minimum(length_m / range_m / np.maximum(slope, 1e-3), np.pi)

    def solved(
        self, cells: Cells, sources: tuple[Angles, ...]
    ) -> tuple[Complex[np.ndarray, "cell source"], Float[np.ndarray, "cell source"]]:
        """Return the amplitudes of sources by least squares, and h (see `array_arrival`) of each; NaN for one place."""
        step = 0.01 * self._step
        a, ahead, behind = (
            np.stack([self.vectors(Angles(w.phi_rad + side * step, w.cone), cells) for w in sources], axis=1)
            for side in (0, 1, -1)
        )
        gram = a.conj() @ np.swapaxes(a, 1, 2)
        separable = np.flatnonzero(np.abs(np.linalg.det(gram)) >= 1e-6 * self.array.gain ** len(sources))
        amplitude, h = np.zeros(a.shape[:2], dtype=np.complex128), np.full(a.shape[:2], np.nan)
        amplitude[separable] = np.einsum("nsc,nc->ns", separators(a[separable]), cells.x[separable])
        h[separable] = np.maximum(outside(a[separable], (ahead - behind)[separable] / (2 * step)), 1e-9)
        return amplitude, h
