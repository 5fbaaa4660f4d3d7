"""Ground behind a volume of rain: what one pulse says for every range at which the volume may end on a surface.

Rain fills the beam as far as the ground, and behind the ground there is silence. So ground shows twice in a profile:
by its own echo, and by the end of the rain's. The second is there however weak the first is. In range cells, with
powers over the volume's mean V(r) and the receiver's noise n, the mean about a surface whose axis range is c is

    mu(x) = (1 - F(x - d)) (1 - k) + k + g f(x),       x = r - c,   k = n / (V + n)

f is the two-way beam across the surface, spread by the window (peak 1), F its integral: the share of the beam that
has met the ground. g is the ground's strongest mean over the volume's. d is the Doppler shift of falling drops
against still ground, which moves the end of the rain: an up-sweep reads what recedes as far, so that rain under a
beam that looks down seems to reach into the ground. Powers are exponential about mu, so the log-likelihood against a
volume without end is the sum of -log mu - P (1 / mu - 1). Behind the window of shapes the silence goes on counting,
each cell down to a bounded loss: a lone echo from behind (a side lobe, a double bounce) must not outweigh it.

Bound: of W independent cells in which ground raises the mean from 1 to 1 + g, the log-likelihood gains
W (g - log(1 + g)) on average; N competing places cost log N. The silence behind adds log(1 / k) - 1 + k per cell,
for as many cells as are sampled behind the ground, which is why the volume's own end finds the ground when g < 1.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Float32, Int
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import gaussian_filter1d
from scipy.special import logsumexp

from sionna_radar.detection.beam_profile import BeamProfile
from sionna_radar.detection.volume_clutter import VolumeClutter

# Cells on each side of the axis range in which shapes are compared.
HALF = 40
WIDTHS_CELLS = np.geomspace(1.0, 14.0, 8)
# Behind the ground nothing is taken to lie farther below the volume than this: side lobes, echoes by two bounces.
SILENCE = 0.01
LARGEST_LOSS = 3.0
# Cells that must be sampled behind the ground: rain that goes on as far as the beat is sampled ends on nothing.
FEWEST_BEHIND = 8
ROWS_AT_ONCE = 32
FINE = 4
# Uncertainty of an echo's width about that of level ground, in nepers, and the mean square of the ground's slope.
WIDTH_SPREAD = 0.3
SQUARE_SLOPE = 0.1


@dataclass(frozen=True, kw_only=True, eq=False)
class VolumeEnd:
    """The likelihood of ground behind a volume, on range cells.

    volume: mean power of the volume and of the noise; level, level_share: ground over volume, and how often it is so.
    beam: the beam in the plane of incidence. cell_m: range cell. looks: independent looks that a cell is worth.
    response: power response of the spectrum to one range, on cells.
    first: cell where the ground may begin; cells: how many there are.
    """

    volume: VolumeClutter
    beam: BeamProfile
    cell_m: float
    looks: float
    response: Float[np.ndarray, " tap"]
    first: int
    cells: int

    def over_volume(self, power: Float[np.ndarray, "pulse cell"]) -> Float[np.ndarray, "pulse cell"]:
        """Return powers over the mean of volume and noise; 1 where no ground may be."""
        ratio = power / self.volume.background
        ratio[:, : self.first] = 1.0
        return np.minimum(ratio, 1e6)

    def evidence(
        self,
        ratio: Float[np.ndarray, "pulse cell"],
        cos_nadir: Float[np.ndarray, " pulse"],
        drift_m: Float[np.ndarray, " pulse"],
    ) -> Float[np.ndarray, "pulse cell"]:
        """Return the log-likelihood of ground at each cell against a volume without end; -inf where none may be."""
        out = np.empty(ratio.shape)
        for rows, terms in self._terms(ratio, cos_nadir, drift_m):
            out[rows] = _log_sum(terms.reshape(*terms.shape[:2], -1))
        return out

    def by_level(
        self,
        ratio: Float[np.ndarray, "pulse cell"],
        cos_nadir: Float[np.ndarray, " pulse"],
        drift_m: Float[np.ndarray, " pulse"],
    ) -> Float[np.ndarray, "pulse cell level"]:
        """Return the log-likelihood for each level of the ground, the levels' shares counted in."""
        out = np.empty((*ratio.shape, len(self.volume.level)), dtype=np.float32)
        for rows, terms in self._terms(ratio, cos_nadir, drift_m):
            out[rows] = _log_sum(terms.swapaxes(2, 3))
        return out

    def shape_at(
        self,
        ratio: Float[np.ndarray, "pulse cell"],
        cell: Int[np.ndarray, " pulse"],
        cos_nadir: Float[np.ndarray, " pulse"],
        drift_m: Float[np.ndarray, " pulse"],
    ) -> tuple[Float[np.ndarray, " pulse"], Float[np.ndarray, " pulse"]]:
        """Return the mean width in cells and the mean level of the ground's echo about given cells."""
        width, level = np.empty(len(ratio)), np.empty(len(ratio))
        own = np.clip(cell, self._columns[0], self._columns[-1])
        silence, _ = self._silence(ratio)
        window, expected = self._windows(ratio), self._expected_width(cos_nadir, self._columns)
        for row, at in enumerate(own):
            here = np.array([at])
            terms = self._compare(window[None, row, here], self._step(drift_m[row]), float(silence[at]), here)[0, 0]
            terms = terms + expected[row, at - self._columns[0]] + self._log_level_share
            share = np.exp(terms - logsumexp(terms))
            width[row] = np.exp(share.sum(axis=1) @ np.log(WIDTHS_CELLS))
            level[row] = share.sum(axis=0) @ self.volume.level
        return width, level

    def in_air(
        self,
        centre: Float[np.ndarray, " pulse"],
        width: Float[np.ndarray, " pulse"],
        drift_m: Float[np.ndarray, " pulse"],
        place: Float[np.ndarray, " place"],
    ) -> Float[np.ndarray, "pulse place"]:
        """Return the share of the volume's mean that is there at places in cells, before and over the ground."""
        out = np.empty((len(centre), len(place)))
        at = np.arange(-HALF, HALF + 1)
        nearest = np.argmin(np.abs(np.log(width)[:, None] - np.log(WIDTHS_CELLS)), axis=1)
        for row, (one, number) in enumerate(zip(centre, nearest, strict=True)):
            air, _ = self._shapes(self._step(drift_m[row]))
            out[row] = np.interp(place - one, at, air[number], left=1.0, right=0.0)
        return out

    def _terms(
        self,
        ratio: Float[np.ndarray, "pulse cell"],
        cos_nadir: Float[np.ndarray, " pulse"],
        drift_m: Float[np.ndarray, " pulse"],
    ) -> Iterator[tuple[Int[np.ndarray, " row"], Float32[np.ndarray, "row cell width level"]]]:
        """Yield rows and their log-likelihoods for cells, widths and levels."""
        silence, behind = self._silence(ratio)
        window = self._windows(ratio)
        steps = np.array([self._step(one) for one in drift_m])
        for step in sorted({int(one) for one in steps}):
            group = np.flatnonzero(steps == step)
            for start in range(0, len(group), ROWS_AT_ONCE):
                rows = group[start : start + ROWS_AT_ONCE]
                shape = (len(rows), self.cells, len(WIDTHS_CELLS), len(self.volume.level))
                terms = np.full(shape, -np.inf, dtype=np.float32)
                for part, silent in _runs(silence, self._columns):
                    some = np.ix_(rows, part)
                    terms[:, part] = self._compare(window[some], step, silent, part) + behind[some][..., None, None]
                terms[:, self._columns] += self._expected_width(cos_nadir[rows], self._columns)
                terms += self._log_level_share
                yield rows, terms

    @property
    def _columns(self) -> Int[np.ndarray, " column"]:
        """Cells that the ground may lie in."""
        return np.arange(self.first, self.cells - FEWEST_BEHIND)

    @property
    def _log_level_share(self) -> Float32[np.ndarray, " level"]:
        return np.log(self.volume.level_share).astype(np.float32)

    def _windows(self, ratio: Float[np.ndarray, "pulse cell"]) -> Float32[np.ndarray, "pulse cell tap"]:
        """Return the cells about each cell: volume alone before the first; beyond the last nothing is known."""
        pad = np.pad(ratio.astype(np.float32), ((0, 0), (HALF, HALF)), constant_values=1.0)
        pad[:, -HALF:] = 0.0
        return sliding_window_view(pad, 2 * HALF + 1, axis=1)

    def _compare(
        self,
        window: Float32[np.ndarray, "pulse cell tap"],
        step: int,
        silence: float,
        cell: Int[np.ndarray, " cell"],
    ) -> Float32[np.ndarray, "pulse cell width level"]:
        air, ground = self._shapes(step)
        mean = (air * (1 - silence) + silence)[:, None] + self.volume.level[:, None] * ground[:, None]
        mean = mean.reshape(-1, mean.shape[-1])
        slope = -(1 / mean - 1).T.astype(np.float32)
        # Taps beyond the last cell do not count.
        inside = np.minimum(self.cells - cell + HALF, 2 * HALF + 1)
        constant = -np.cumsum(np.log(mean), axis=1)[:, inside - 1].T.astype(np.float32)
        flat = np.ascontiguousarray(window).reshape(-1, window.shape[-1])
        terms = ((flat @ slope).reshape(*window.shape[:2], -1) + constant) * np.float32(self.looks)
        return terms.reshape(*window.shape[:2], len(WIDTHS_CELLS), len(self.volume.level))

    def _silence(
        self, ratio: Float[np.ndarray, "pulse cell"]
    ) -> tuple[Float[np.ndarray, " cell"], Float[np.ndarray, "pulse cell"]]:
        """Return the mean behind the ground over the volume's, in steps of 3 dB, and what all cells behind say."""
        silence = np.clip(self.volume.noise / self.volume.background, SILENCE, 1.0)
        one = np.maximum(-np.log(silence) - ratio * (1 / silence - 1), -LARGEST_LOSS) * self.looks
        behind = np.zeros((len(ratio), self.cells + HALF + 1))
        behind[:, : self.cells] = np.cumsum(one[:, ::-1], axis=1)[:, ::-1]
        return 2.0 ** (np.round(np.log2(silence))), behind[:, HALF + 1 :]

    def _expected_width(
        self, cos_nadir: Float[np.ndarray, " pulse"], cell: Int[np.ndarray, " cell"]
    ) -> Float32[np.ndarray, "pulse cell width 1"]:
        """Return the log-probability of the widths, from what the beam spans on level ground at each range."""
        square_tan = 1 / np.maximum(cos_nadir, 0.05) ** 2 - 1
        spread = np.sqrt(self.beam.share @ self.beam.sine**2)
        level = np.maximum(cell, 1) * spread * np.sqrt(square_tan + SQUARE_SLOPE)[:, None]
        level = np.clip(level, WIDTHS_CELLS[0], WIDTHS_CELLS[-1])
        log = -0.5 * ((np.log(WIDTHS_CELLS) - np.log(level)[..., None]) / WIDTH_SPREAD) ** 2
        return (log - logsumexp(log, axis=-1, keepdims=True))[..., None].astype(np.float32)

    def _step(self, drift_m: float) -> int:
        """Return a drift in half cells, to which the shapes are made."""
        return round(2 * drift_m / self.cell_m)

    def _shapes(self, step: int) -> tuple[Float[np.ndarray, "width tap"], Float[np.ndarray, "width tap"]]:
        return _shapes(
            step, self.volume.drift_spread, self.beam.sine.tobytes(), self.beam.share.tobytes(), self.response.tobytes()
        )


def _log_sum(terms: Float32[np.ndarray, "... term"]) -> Float32[np.ndarray, "..."]:
    """Return log sum exp over the last axis, in the terms' own precision; -inf of nothing but -inf."""
    most = terms.max(axis=-1)
    with np.errstate(divide="ignore"):
        total = np.exp(terms - np.where(np.isfinite(most), most, 0.0)[..., None]).sum(axis=-1)
        return np.asarray(np.log(total) + np.where(np.isfinite(most), most, 0.0))


def _runs(
    silence: Float[np.ndarray, " cell"], columns: Int[np.ndarray, " column"]
) -> Iterator[tuple[Int[np.ndarray, " part"], float]]:
    """Yield the runs of columns with equal silence."""
    for part in np.split(columns, np.flatnonzero(np.diff(silence[columns])) + 1):
        if len(part):
            yield part, float(silence[part[0]])


@lru_cache(maxsize=256)
def _shapes(
    step: int, spread: float, sine: bytes, share: bytes, response: bytes
) -> tuple[Float[np.ndarray, "width tap"], Float[np.ndarray, "width tap"]]:
    """Return 1 - F of the drifting volume and the ground's f, for all widths, spread by the window."""
    angle, power, window = (np.frombuffer(part) for part in (sine, share, response))
    angle = angle / np.sqrt(power @ angle**2)
    density = power / power.max()
    place = np.arange(-HALF * FINE, HALF * FINE + 1) / FINE
    half = len(window) // 2
    airs, grounds = [], []
    for width in WIDTHS_CELLS:
        beam = np.interp(place / width, angle, density, left=0.0, right=0.0)
        met = np.cumsum(beam) / beam.sum()
        air = np.interp(place - step / 2, place, 1 - met, left=1.0, right=0.0)
        air = gaussian_filter1d(air, spread * abs(step) / 2 * FINE + 1e-3, mode="nearest")[::FINE]
        airs.append(np.convolve(np.pad(air, half, mode="edge"), window, "valid"))
        # Each cell takes the power of its whole length.
        ground = np.convolve(np.convolve(beam, np.ones(FINE) / FINE, "same")[::FINE], window, "same")
        grounds.append(ground / ground.max())
    return np.array(airs), np.array(grounds)
