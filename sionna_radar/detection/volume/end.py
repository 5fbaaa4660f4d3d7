"""Likelihood of the range at which ground ends volume clutter such as rain.

The likelihood is that of one pulse. Rain fills the beam up to the ground, with receiver noise alone behind it. So
ground shows twice in a profile: by its own echo, and by the end of the rain's, present however weak the first is. In
range cells, with powers over the volume's mean V(r) and the receiver's noise n, the mean about a surface whose
axis range is c is

    mu(x) = (1 - F(x - d)) (1 - k) + k + G f(x),       x = r - c,   k = n / (V + n)

f is the two-way beam across the surface, spread by the window (its cells add up to one), F its integral: the share of
the beam that has hit the ground. G is the power of the ground's whole echo over the volume's in one cell. d is the
Doppler shift of moving drops relative to stationary ground, which moves the end of the rain: in an up-sweep receding
targets appear too far, so that rain falling under a downward beam seems to reach into the ground. Powers are
exponential about mu, so the log-likelihood against a volume without end is the sum of -log mu - P (1 / mu - 1). That
sum is largest at the true mean whatever the distribution of P, as long as the mean itself is right: where the floor k
is kept above the receiver noise because of side lobes, powers are raised by as much. Behind the window of shapes the
silent cells continue to count, each down to a bounded loss, so that a single echo from behind (a side lobe, a double
bounce) does not outweigh them.

Bound: of W independent cells in which ground raises the mean from 1 to 1 + g, the log-likelihood gains
W (g - log(1 + g)) on average; N competing positions cost log N. Each cell sampled behind the ground adds
log(1 / k) - 1 + k, which is why the end of the volume reveals the ground when g < 1.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from numpy.lib.stride_tricks import sliding_window_view

from sionna_radar.detection.ranging.plane_fit import BeamProfile
from sionna_radar.detection.volume.clutter import VolumeClutter
from sionna_radar.detection.volume.echo_widths import EchoWidths
from sionna_radar.detection.volume.ground import SLOPES, GroundBehind
from sionna_radar.detection.volume.shapes import (
    FINE,
    LARGEST_SHIFT,
    air_shapes,
    beam_sigma,
    echo_width,
    ground_shapes,
    level_tangent,
)
from sionna_radar.foundation.columns import Columns
from sionna_radar.foundation.numerics import log_sum_exp
from sionna_radar.foundation.threads import MIN_ROWS, chunks, chunks_of_bytes

LEAST_PROBABILITY = 1e-12
# Half-length of the window in which shapes are compared, in standard deviations of the widest echo.
HALF_WIDTHS = 40 / 14
LARGEST_LOSS = 3.0
# Minimum number of cells behind the ground: rain that continues to the last range cell shows no end.
MIN_BEHIND = 8
# Ranges whose log-likelihood is this far below a pulse's maximum are ignored for ground and motion (nepers).
NEGLIGIBLE = 15.0
MAX_OVER_VOLUME = 1e8
# Steps of the volume's strength around a pulse (2 dB).
STRENGTH_STEP = 10.0**0.2


@dataclass(frozen=True, kw_only=True, eq=False)
class Views(Columns):
    """Viewing geometry of volume and ground in each pulse.

    down: cosine of the boresight's angle from nadir.
    shift_m: increase of the ground's ranges by the platform's motion.
    drift_m: increase of the volume's ranges by motion, relative to those of the ground.
    strength: mean of the volume around each pulse over that of the survey.
    """

    down: Float[np.ndarray, " pulse"]
    shift_m: Float[np.ndarray, " pulse"]
    drift_m: Float[np.ndarray, " pulse"]
    strength: Float[np.ndarray, " pulse"]


@dataclass(frozen=True, kw_only=True, eq=False)
class ByWidth:
    """Likelihood of ground at each cell that may hold it, for echoes of each width.

    most: largest log-likelihood of a cell. relative: likelihoods over that.
    """

    most: Float[np.ndarray, "pulse column"]
    relative: Float32[np.ndarray, "pulse column width"]


@dataclass(frozen=True, kw_only=True, eq=False)
class VolumeEnd:
    """The likelihood of ground behind a volume, on range cells.

    volume: mean power of the volume and of the noise. ground: prior of the ground's echo.
    spread_m: standard deviation of the drift, from drops that fall at different speeds.
    beam: the beam in the plane of incidence. cell_m: range cell. looks: independent looks per cell.
    response: power response of the spectrum to a point target, `FINE` samples per cell.
    first: first cell that may hold ground; cells: number of cells.
    floor_share: lowest mean behind the ground, over the volume's.
    width_spread_nepers: uncertainty of an echo's width on ground of a known slope.
    widths: standard deviations of the echoes compared, in cells; see `widths_up_to`.
    """

    volume: VolumeClutter
    ground: GroundBehind
    spread_m: float
    beam: BeamProfile
    cell_m: float
    looks: float
    response: Float[np.ndarray, " tap"]
    first: int
    cells: int
    floor_share: float
    width_spread_nepers: float
    widths: Float[np.ndarray, " width"]

    def over_volume(
        self, power: Float[np.ndarray, "pulse cell"], strength: Float[np.ndarray, " pulse"]
    ) -> Float[np.ndarray, "pulse cell"]:
        """Return powers over the mean of volume and noise; 1 where ground is ruled out."""
        background = strength[:, None] * self.volume.mean + self.volume.noise
        ratio = power / background + np.maximum(self.floor_share - self.volume.noise / background, 0.0)
        ratio[:, : self.first] = 1.0
        return np.minimum(ratio, MAX_OVER_VOLUME)

    def ground_width(
        self, range_cells: Float[np.ndarray, "*place"], down: Float[np.ndarray, "*view"]
    ) -> Float[np.ndarray, "*both"]:
        """Return the standard deviation of the echo of level ground at ranges, in cells."""
        return echo_width(self.beam, range_cells, down)

    def before_ground(
        self, range_cells: Float[np.ndarray, "*place"], down: Float[np.ndarray, "*view"], widths: float
    ) -> Float[np.ndarray, "*both"]:
        """Return the cells by which the edge of the beam, `widths` sigmas off its axis, meets level ground sooner."""
        angle, tangent = widths * beam_sigma(self.beam), level_tangent(down)
        return np.asarray(range_cells * (1 - 1 / (np.cos(angle) + tangent * np.sin(angle))))

    def goes_on(
        self, ratio: Float[np.ndarray, "pulse cell"], strength: Float[np.ndarray, " pulse"]
    ) -> Float[np.ndarray, "pulse cell"]:
        """Return the log-likelihood of a volume, against silence, in each cell and those up to some later one."""
        silence = self.volume.noise / (strength[:, None] * self.volume.mean + self.volume.noise)
        silence = np.clip(silence, self.floor_share, 1.0)
        gain = np.minimum(np.log(silence) + ratio * (1 / silence - 1), LARGEST_LOSS) * self.looks
        total = np.cumsum(gain, axis=1)
        most = np.maximum.accumulate(total[:, ::-1], axis=1)[:, ::-1]
        return np.asarray(most - total + gain)

    def by_width(
        self, ratio: Float[np.ndarray, "pulse cell"], views: Views, level_weight: Float[np.ndarray, "pulse level"]
    ) -> ByWidth:
        """Return the likelihood of echoes of each width at each cell that may hold ground, against no end."""
        shape = (len(ratio), len(self._columns))
        most, relative = np.empty(shape), np.empty((*shape, len(self.widths)), dtype=np.float32)
        log_weight = np.log(level_weight).astype(np.float32)[:, None, :, None]
        for rows, _, terms in self._terms(ratio, views):
            log = log_sum_exp(terms + log_weight[rows], axis=2)
            most[rows] = log.max(axis=2)
            relative[rows] = np.exp(log - most[rows][..., None])
        return ByWidth(most=most, relative=relative)

    def evidence(
        self, by_width: ByWidth, views: Views, slope_weight: Float[np.ndarray, "kind slope"], tilt: float = 0.0
    ) -> Float[np.ndarray, "kind pulse cell"]:
        """Return the log-likelihood of ground at each cell against a volume without end; -inf where ruled out.

        by_width: see the method of that name. slope_weight: probability of each of `SLOPES`, of kinds of ground.
        tilt: angle by which the ground rises away from the radar on average.
        """
        out = np.full((len(slope_weight), len(by_width.most), self.cells), -np.inf)
        for low, high in chunks_of_bytes(len(by_width.most), len(slope_weight) * by_width.relative[:1].nbytes):
            rows, some = slice(low, high), views.rows(slice(low, high))
            near, far, fraction = self._prior.up_to(
                some.down, self._range_cells(some, self._columns), slope_weight, tilt
            )
            # The sum of a width's likelihood times its probability, by parts.
            relative = by_width.relative[rows]
            less = relative[..., :-1] - relative[..., 1:]
            nearer, farther = (np.einsum("kpcw,pcw->kpc", up_to, less) for up_to in (near, far))
            expected = nearer + fraction * (farther - nearer) + relative[..., -1]
            out[:, rows, self._columns] = np.log(np.maximum(expected, LEAST_PROBABILITY)) + by_width.most[rows]
        return out

    def by_slope_and_level(
        self, ratio: Float[np.ndarray, "pulse cell"], views: Views
    ) -> tuple[Float32[np.ndarray, "slope pulse level"], Int[np.ndarray, " pulse"]]:
        """Return the log-likelihood of each slope and level of the ground over all ranges, and the best cells."""
        out = np.empty((len(SLOPES), len(ratio), len(self.ground.level)), dtype=np.float32)
        cell = np.empty(len(ratio), dtype=np.int64)
        for rows, columns, terms in self._terms(ratio, views, self._candidates(ratio, views)):
            peak = terms.max(axis=(2, 3))
            cell[rows] = columns[peak.argmax(axis=1)]
            relevant = _relevant(peak)
            some = views.rows(rows)
            width = self._prior.of(some.down, self._range_cells(some, columns), np.eye(len(SLOPES)))
            for i, row in enumerate(rows):
                of_row = np.swapaxes(terms[i, relevant[i]], 1, 2).reshape(-1, out.shape[2])
                most = of_row.max(axis=0)
                of_row -= most
                total = width[:, i, relevant[i]].reshape(len(out), -1) @ np.exp(of_row, out=of_row)
                out[:, row] = np.log(np.maximum(total, LEAST_PROBABILITY)) + most
        return out, cell

    def shape_at(
        self,
        ratio: Float[np.ndarray, "pulse cell"],
        cell: Int[np.ndarray, " pulse"],
        views: Views,
        level_weight: Float[np.ndarray, "pulse level"],
    ) -> tuple[Float[np.ndarray, " pulse"], Float[np.ndarray, " pulse"]]:
        """Return the mean width (cells) of the ground's echo at given cells, and its peak over the volume."""
        width, level = np.empty(len(ratio)), np.empty(len(ratio))
        clipped = np.clip(cell, self._columns[0], self._columns[-1])
        window, range_cells = self._windows(ratio), self._range_cells(views, clipped[:, None])
        expected = self._prior.of(views.down, range_cells, self.ground.slope_weight[None])
        expected = np.log(np.maximum(expected[0, :, 0], LEAST_PROBABILITY))
        for row, at in enumerate(clipped):
            column = np.array([at])
            strength = _strength_step(views.strength[row])
            terms = self._compare(window[None, row, column], self._step(views.drift_m[row]), strength, column, int(at))
            terms = terms[0, 0] + expected[row] + np.log(level_weight[row])[:, None]
            probability = np.exp(terms - log_sum_exp(terms, axis=None))
            width[row] = np.exp(probability.sum(axis=0) @ np.log(self.widths))
            level[row] = probability.sum(axis=1) @ self.ground.level / STRENGTH_STEP**strength
        return width, level / (np.sqrt(2 * np.pi) * width)

    def shared_sigma_cells(
        self, cell: int, down: float, pulses: int, volume_information: float, drift: tuple[float, float]
    ) -> float:
        """Return the standard deviation of the range error that pulses on level ground share, in cells.

        What pulses are compared with is learned from some of them: the ground's level and the volume's mean at the
        ground. Each pulse has a range of its own. With the Fisher information I of one pulse on its range c and on what
        is shared, s, an error e of s moves ranges by b e, b = I_cs / I_cc, and n pulses leave to s the precision
        n (I_ss - I_sc I_cs / I_cc) beside what is known of it otherwise. Pulses far away have another level. The
        volume's motion is not learned from the ground; an error of it moves ranges, and what is learned with it.

        cell: the ground's. down: cosine of the boresight's angle from nadir. pulses: number n of those learned from.
        volume_information: on the volume's mean at the ground, per square neper, from cells before it.
        drift: of the volume, and its standard deviation, m.
        """
        around = np.clip(cell + np.arange(-self._half, self._half + 1), 0, self.cells - 1)
        silence = self._noise_fraction(0)[around]
        step, drift_sigma_m = self._step(drift[0]), drift[1]
        width = int(np.argmin(np.abs(np.log(self.widths / self.ground_width(np.array(float(cell)), np.array(down))))))
        level = np.exp(self.ground.level_weight @ np.log(self.ground.level))
        volume = self._air(step)[width] * (1 - silence)
        ground = self._ground[width] * (1 - silence)
        ground *= level / max(ground.sum(), LEAST_PROBABILITY)
        moved = (1 - silence) * (self._air(step + FINE)[width] - self._air(step - FINE)[width]) / 2
        nearer = moved - np.gradient(ground)
        slopes = np.stack([nearer, ground, volume, moved]) / (volume + silence + ground)
        information = self.looks * slopes @ slopes.T
        shift = information[0, 1:] / information[0, 0]
        of_one = information[1:, 1:] - np.outer(information[0, 1:], shift)
        alike = pulses if self.ground.nearby is None else self.ground.nearby.together
        of_shared = alike * of_one
        of_shared[1:, 1:] += (pulses - alike) * (of_one[1:, 1:] - np.outer(of_one[0, 1:], of_one[0, 1:]) / of_one[0, 0])
        learned, drift = of_shared[:2, :2] + np.diag([0.0, volume_information]), of_shared[:2, 2]
        by_drift = shift[2] - shift[:2] @ np.linalg.solve(learned, drift)
        of_learned = shift[:2] @ np.linalg.solve(learned, shift[:2])
        return float(np.sqrt(of_learned + (by_drift * drift_sigma_m / self.cell_m) ** 2))

    def in_air(
        self,
        centre: Float[np.ndarray, " pulse"],
        width: Float[np.ndarray, " pulse"],
        drift_m: Float[np.ndarray, " pulse"],
        place: Float[np.ndarray, " place"],
    ) -> Float[np.ndarray, "pulse place"]:
        """Return the residual fraction of the volume's mean at positions (in cells) before and across the ground."""
        out = np.empty((len(centre), len(place)))
        at = np.arange(-self._half, self._half + 1)
        nearest = np.argmin(np.abs(np.log(width)[:, None] - np.log(self.widths)), axis=1)
        for row, (centre_cell, number) in enumerate(zip(centre, nearest, strict=True)):
            air = self._air(self._step(drift_m[row]))
            out[row] = np.interp(place - centre_cell, at, air[number], left=1.0, right=0.0)
        return out

    def _candidates(self, ratio: Float[np.ndarray, "pulse cell"], views: Views) -> Bool[np.ndarray, "pulse column"]:
        """Return the cells of `_columns` that may hold the ground, by every other width and level.

        The likelihood on the finer steps is larger by less than what is negligible: half of a step is 2 dB of the
        level, 20 % of the width.
        """
        coarse = replace(
            self,
            widths=self.widths[::-2][::-1],
            ground=replace(self.ground, level=self.ground.level[::2], level_weight=self.ground.level_weight[::2]),
        )
        out = np.empty((len(ratio), len(self._columns)), dtype=bool)
        for rows, _, terms in coarse._terms(ratio, views):
            out[rows] = _relevant(terms.max(axis=(2, 3)), 2 * NEGLIGIBLE)
        return out

    def _terms(
        self,
        ratio: Float[np.ndarray, "pulse cell"],
        views: Views,
        wanted: Bool[np.ndarray, "pulse column"] | None = None,
    ) -> Iterator[
        tuple[Int[np.ndarray, " row"], Int[np.ndarray, " used"], Float32[np.ndarray, "row used level width"]]
    ]:
        """Yield rows, cells and their log-likelihoods for all widths and levels, equally weighted.

        wanted: cells of `_columns` of which one is needed in some row; None for all.
        """
        window = self._windows(ratio)
        steps = [(self._step(one), _strength_step(two)) for one, two in zip(views.drift_m, views.strength, strict=True)]
        for step, strength in sorted(set(steps)):
            group = np.flatnonzero([one == (step, strength) for one in steps])
            silence = self._silence(strength)
            behind = self._behind(ratio[group], silence)
            for low, high in chunks(len(group), MIN_ROWS):
                rows = group[low:high]
                used = self._columns if wanted is None else self._columns[wanted[rows].any(axis=0)]
                shape = (len(rows), len(used), len(self.ground.level), len(self.widths))
                terms = np.empty(shape, dtype=np.float32)
                for span in _spans(silence, self._columns, self._half):
                    first, last = np.searchsorted(used, (span[0], span[-1] + 1))
                    if first == last:
                        continue
                    columns = used[first:last]
                    compared = self._compare(
                        window[np.ix_(rows, columns)], step, strength, columns, int(span[len(span) // 2])
                    )
                    np.add(compared, behind[low:high, columns][..., None, None], out=terms[:, first:last])
                yield rows, used, terms

    @cached_property
    def _columns(self) -> Int[np.ndarray, " column"]:
        """Cells that may contain the ground."""
        return np.arange(self.first, self.cells - MIN_BEHIND)

    def _windows(self, ratio: Float[np.ndarray, "pulse cell"]) -> Float32[np.ndarray, "pulse cell tap"]:
        """Return the cells around each cell: volume only before the first; unknown beyond the last."""
        half = self._half
        pad = np.pad(ratio.astype(np.float32), ((0, 0), (half, half)), constant_values=1.0)
        pad[:, -half:] = 0.0
        return sliding_window_view(pad, 2 * half + 1, axis=1)

    def _compare(
        self,
        window: Float32[np.ndarray, "pulse cell tap"],
        step: int,
        strength: int,
        cell: Int[np.ndarray, " cell"],
        middle: int,
    ) -> Float32[np.ndarray, "pulse cell level width"]:
        """Return the log-likelihoods of cells, with the noise as around the middle of their span."""
        around = middle + np.arange(-self._half, self._half + 1)
        silence = self._noise_fraction(strength)[np.clip(around, 0, self.cells - 1)]
        # Power falls as r^-2, as that of the volume does: over the volume and the noise it is less where the noise is.
        air, ground = self._air(step), self._ground * (1 - silence)
        ground /= np.maximum(ground.sum(axis=1, keepdims=True), LEAST_PROBABILITY)
        level = self.ground.level / STRENGTH_STEP**strength
        mean = air * (1 - silence) + silence + level[:, None, None] * ground
        # Taps beyond the last cell do not count.
        taps = np.minimum(self.cells - cell + self._half, 2 * self._half + 1)
        constant = -self.looks * np.cumsum(np.log(mean), axis=-1)[..., taps - 1]
        slope, behind = (-self.looks * (1 / of - 1) for of in (mean, silence))
        flat = np.ascontiguousarray(window).reshape(-1, window.shape[-1])
        terms = np.empty((len(flat), *mean.shape[:2]), dtype=np.float32)
        for widths, first, last in _differing(slope, behind):
            across = slope[:, widths, first:last].reshape(-1, last - first).T.astype(np.float32)
            of_widths = (flat[:, first:last] @ across).reshape(len(flat), len(level), -1)
            beyond = (flat[:, last:] @ behind[last:].astype(np.float32))[:, None, None]
            np.add(of_widths, beyond, out=terms[..., widths])
        terms = terms.reshape(*window.shape[:2], *terms.shape[1:])
        terms += np.moveaxis(constant, -1, 0).astype(np.float32)
        return terms

    def _noise_fraction(self, strength: int) -> Float[np.ndarray, " cell"]:
        """Return the mean behind the ground over the volume's."""
        noise_fraction = self.volume.noise / (STRENGTH_STEP**strength * self.volume.mean + self.volume.noise)
        return np.clip(noise_fraction, self.floor_share, 1.0)

    def _silence(self, strength: int) -> Float[np.ndarray, " cell"]:
        """Return the same in steps of 3 dB."""
        steps = np.round(np.log2(self._noise_fraction(strength) / self.floor_share))
        return np.minimum(self.floor_share * 2.0**steps, 1.0)

    def _behind(
        self, ratio: Float[np.ndarray, "pulse cell"], silence: Float[np.ndarray, " cell"]
    ) -> Float32[np.ndarray, "pulse cell"]:
        """Return the log-likelihood from all cells behind the window of each cell."""
        per_cell = np.maximum(-np.log(silence) - ratio * (1 / silence - 1), -LARGEST_LOSS) * self.looks
        behind = np.zeros((len(ratio), self.cells + self._half + 1))
        behind[:, : self.cells] = np.cumsum(per_cell[:, ::-1], axis=1)[:, ::-1]
        return behind[:, self._half + 1 :].astype(np.float32)

    @property
    def _half(self) -> int:
        """Half-length of the window in which shapes are compared, in cells."""
        return int(np.ceil(HALF_WIDTHS * self.widths[-1]))

    @cached_property
    def _prior(self) -> EchoWidths:
        return EchoWidths(self.beam, self.widths, self.width_spread_nepers, self.cells)

    def _range_cells(
        self, views: Views, column: Int[np.ndarray, "*#pulse column"]
    ) -> Float[np.ndarray, "pulse column"]:
        """Return the ranges of ground that appears in some cells."""
        return np.asarray(np.clip(column - views.shift_m[:, None] / self.cell_m, 1.0, self.cells))

    def _step(self, drift_m: float) -> int:
        """Return a drift in samples of the shapes."""
        return int(np.clip(round(FINE * drift_m / self.cell_m), -LARGEST_SHIFT * FINE, LARGEST_SHIFT * FINE))

    def _air(self, step: int) -> Float[np.ndarray, "width tap"]:
        spread = round(4 * self.spread_m / self.cell_m) / 4
        return air_shapes(step, spread, *self._planes)

    @property
    def _ground(self) -> Float[np.ndarray, "width tap"]:
        return ground_shapes(*self._planes)

    @cached_property
    def _planes(self) -> tuple[int, int, bytes, bytes, bytes, bytes]:
        beam = self.beam.sine.tobytes(), self.beam.power.tobytes()
        return self._half, self.ground.cell, self.widths.tobytes(), *beam, self.response.tobytes()


def _strength_step(strength: float) -> int:
    return round(float(np.log(strength) / np.log(STRENGTH_STEP)))


def _spans(
    silence: Float[np.ndarray, " cell"], columns: Int[np.ndarray, " column"], reach: int
) -> Iterator[Int[np.ndarray, " part"]]:
    """Yield the spans of columns with equal silence, there and so many cells behind."""
    behind = silence[np.minimum(columns + reach, len(silence) - 1)]
    for span in np.split(columns, np.flatnonzero((np.diff(silence[columns]) != 0) | (np.diff(behind) != 0)) + 1):
        if len(span):
            yield span


def _relevant(peak: Float32[np.ndarray, "pulse column"], below: float = NEGLIGIBLE) -> Bool[np.ndarray, "pulse column"]:
    """Return the cells whose largest log-likelihood is at most so far below that of their pulse."""
    strongest = peak.max(axis=1, keepdims=True)
    # Beyond 2^24 the spacing of float32 exceeds one.
    return np.asarray((peak > strongest - below) | (peak == strongest))


def _differing(
    slope: Float[np.ndarray, "level width tap"], behind: Float[np.ndarray, " tap"]
) -> Iterator[tuple[slice, int, int]]:
    """Yield groups of widths, and the taps in which their slopes are neither zero, before, nor those of silence behind.

    The taps of one group number less than twice as many as those of another of its widths alone.
    """
    least = np.finfo(np.float32).eps * np.abs(slope).max()
    before, after = (np.abs(part).max(axis=0) > least for part in (slope, slope - behind))
    first = before.argmax(axis=1)
    last = np.maximum(slope.shape[-1] - after[:, ::-1].argmax(axis=1), first + 1)
    octave = np.log2(last - first).astype(np.int64)
    edges = [0, *(np.flatnonzero(np.diff(octave)) + 1), len(octave)]
    for low, high in pairwise(edges):
        yield slice(low, high), int(first[low:high].min()), int(last[low:high].max())
