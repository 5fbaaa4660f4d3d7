"""Detection in range-Doppler maps: CFAR over a ring of cells, and clutter-map CFAR.

The ring is a rectangle of training cells less one of guard cells; it wraps at the ends of the range rates, as
frequencies do, and cells whose ring reaches beyond the ends of the ranges are not tested. Windows in both directions
correlate the noise of cells by the product of their correlations.

"CA" takes the mean of the ring. A mean of correlated powers is a sum of independent exponentials, weighted with the
eigenvalues of the cells' covariance over their number, which gives the false-alarm rate exactly (`false_alarm`). "OS"
takes an order statistic, which is robust to a few strong cells in the ring. For correlated cells its rate has no closed
form, so it uses only cells far enough apart to have independent noise.

Clutter-map CFAR compares each cell with its own power in earlier maps. The level of a cell is an exponential mean of
these, Z_n = (1 - w) Z_(n-1) + w P_(n-1). Stationary ground, whatever its power, is not detected; new echoes are. In
noise or in clutter of exponential power, independent in each map, the false-alarm rate after many maps is
(Nitzberg 1986, "Clutter map CFAR analysis", IEEE Trans. Aerosp. Electron. Syst. 22)

    P = prod_(k >= 0) 1 / (1 + a w (1 - w)^k),

and after n maps, the first of which is the first level, 1 / (1 + a (1 - w)^(n - 1)) replaces the remaining factors: so
the threshold is right from the second map on.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from sionna_radar.detection.false_alarm import factor_of_mean, factor_of_ordered
from sionna_radar.foundation.errors import ScenarioError

# Largest noise correlation between a cell and the nearest of its ring, and between the cells of an ordered statistic.
SHARED_NOISE = 0.1
NO_NOISE_SHARED = 0.02
MAX_CELLS = 2000


@dataclass(frozen=True, kw_only=True)
class RingCfar:
    """A detector for range-Doppler maps.

    kind: cell averaging or ordered statistic.
    guard, training: cells on each side of the cell under test: of range rate and of range.
    false_alarm_probability: in one cell.
    rank: of an ordered statistic, as a share of its cells.
    correlation: of the noise at lags of 0, 1, ... cells in range rate and in range; see `RangeDoppler`.
    stride: map bins per cell.
    looks: powers averaged in each cell; only cell averaging supports several.

    Examples
    --------
    >>> import numpy as np
    >>> white = (np.array([1.0]), np.array([1.0]))
    >>> cfar = RingCfar(guard=(1, 1), training=(2, 2), false_alarm_probability=1e-4, correlation=white)
    >>> cfar.cells, round(cfar.factor, 2)  # (1 + factor / 40) ** -40 = 1e-4
    (40, 10.36)
    """

    guard: tuple[int, int]
    training: tuple[int, int]
    false_alarm_probability: float
    correlation: tuple[Float[np.ndarray, " lag"], Float[np.ndarray, " lag"]]
    kind: Literal["CA", "OS"] = "CA"
    rank: float = 0.75
    stride: int = 1
    looks: int = 1

    def __post_init__(self) -> None:
        if self.looks > 1 and self.kind == "OS":
            message = f"'OS' has no false-alarm rate in closed form over {self.looks} looks; set 'CA'"
            raise ScenarioError.of("processing.cfar.kind", message)
        for name, guard, correlation in zip(("rate", "range"), self.guard, self.correlation, strict=True):
            shared = np.flatnonzero(np.abs(correlation) > SHARED_NOISE)[-1]
            if guard < shared:
                message = f"{guard} cells of {name}; the window needs at least {shared}; raise it"
                raise ScenarioError.of("guard", message)
        if not 1 <= self.cells <= MAX_CELLS:
            message = f"{self.training} cells around {self.guard} are {self.cells}; give 1 to {MAX_CELLS} in all"
            raise ScenarioError.of("training", message)

    @property
    def cells(self) -> int:
        """Cells of the ring."""
        return len(self._offsets)

    @cached_property
    def _offsets(self) -> Int[np.ndarray, "cell 2"]:
        """Offsets of the ring from the cell under test, in cells of range rate and of range."""
        spacing = (
            [1, 1]
            if self.kind == "CA"
            else [
                # The smallest lag of cells with independent noise.
                int(np.flatnonzero(np.abs(c) > NO_NOISE_SHARED)[-1]) + 1
                for c in self.correlation
            ]
        )
        reach = np.add(self.guard, self.training)
        axes = [
            step * np.arange(-(extent // step), extent // step + 1) for extent, step in zip(reach, spacing, strict=True)
        ]
        rate, range_ = (axis.ravel() for axis in np.meshgrid(*axes, indexing="ij"))
        outside_guard = (np.abs(rate) > self.guard[0]) | (np.abs(range_) > self.guard[1])
        return np.column_stack([rate, range_])[outside_guard]

    @cached_property
    def factor(self) -> float:
        """Multiple of the ring's level that a cell must exceed."""
        if self.kind == "OS":
            white = np.array([1.0])
            return factor_of_ordered(white, self.cells, 1, self._place, self.false_alarm_probability)
        lag = np.abs(self._offsets[:, None] - self._offsets[None])
        rate, range_ = (_at(c, lag[..., axis]) for axis, c in enumerate(self.correlation))
        weight = np.maximum(np.linalg.eigvalsh(rate * range_), 0.0) / self.cells
        return factor_of_mean(weight, 1, self.false_alarm_probability, self.looks)

    @property
    def _place(self) -> int:
        return max(0, round(self.rank * self.cells) - 1)

    def detected(self, power: Float[np.ndarray, "rate bin"]) -> Bool[np.ndarray, "rate bin"]:
        """Mark the cells of a map that exceed their threshold."""
        return power > self.factor * self._level(power)

    def _level(self, power: Float[np.ndarray, "rate bin"]) -> Float[np.ndarray, "rate bin"]:
        """Return the level of the ring around each cell of a map; infinite where the ring does not fit."""
        reach = (self.guard[1] + self.training[1]) * self.stride
        level = np.full(power.shape, np.inf)
        tested = np.arange(reach, power.shape[1] - reach)
        if len(tested) == 0 or 2 * (self.guard[0] + self.training[0]) * self.stride >= power.shape[0]:
            message = f"a ring of {self.training} around {self.guard} cells does not fit a map of {power.shape}"
            raise ScenarioError.of("training", f"{message}; lower it")
        if self.kind == "OS":
            ring = np.empty((self.cells, power.shape[0], len(tested)))
            for cell, (rate, range_) in enumerate(self._offsets * self.stride):
                ring[cell] = np.roll(power, -rate, axis=0)[:, tested + range_]
            level[:, tested] = np.partition(ring, self._place, axis=0)[self._place]
            return level
        total = np.zeros((power.shape[0], len(tested)))
        for rate, range_ in self._offsets * self.stride:
            total += np.roll(power, -rate, axis=0)[:, tested + range_]
        level[:, tested] = total / self.cells
        return level


def _at(correlation: Float[np.ndarray, " lag"], lag: Int[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Return the correlation at lags, zero beyond the tabulated ones."""
    padded = np.append(correlation, 0.0)
    return padded[np.minimum(lag, len(correlation))]


# Smaller weights of earlier maps are left out of the factor.
MIN_SHARE = 1e-9


@dataclass(kw_only=True)
class ClutterMap:
    """Level of every cell over consecutive maps.

    weight: of the latest map in the level, between 0 and 1.
    false_alarm_probability: in one cell.

    Examples
    --------
    >>> import numpy as np
    >>> clutter = ClutterMap(weight=0.1, false_alarm_probability=1e-3)
    >>> bool(clutter.detected(np.ones((4, 8))).any())  # nothing is known of the first map
    False
    >>> moved = np.ones((4, 8))
    >>> moved[2, 5] = 5000.0
    >>> int(clutter.detected(moved).sum())
    1
    """

    weight: float
    false_alarm_probability: float
    looks: int = 1
    _level: Float[np.ndarray, "rate bin"] | None = field(default=None, repr=False)
    _maps: int = 0

    def __post_init__(self) -> None:
        if not 0 < self.weight < 1:
            raise ScenarioError.of("weight", f"{self.weight:g} is no share; give one between 0 and 1")

    @property
    def factor(self) -> float:
        """Multiple of the level that a cell of the next map must exceed; infinite before the first."""
        if self._maps == 0:
            return np.inf
        return factor_of_mean(self._shares(), 1, self.false_alarm_probability, self.looks)

    def _shares(self) -> Float[np.ndarray, " map"]:
        """Return the shares of earlier maps in the level, the latest first."""
        enough = int(np.ceil(np.log(MIN_SHARE) / np.log(1 - self.weight)))
        decay = (1 - self.weight) ** np.arange(min(self._maps, enough))
        shares = self.weight * decay
        if self._maps <= enough:
            shares[-1] = decay[-1]  # of the first map, which was the first level
        return shares

    def detected(self, power: Float[np.ndarray, "rate bin"]) -> Bool[np.ndarray, "rate bin"]:
        """Mark the cells of a map that exceed their threshold, and update the levels with it."""
        if self._level is None:
            self._level = power.copy()
            exceeds = np.zeros(power.shape, dtype=bool)
        else:
            exceeds = power > self.factor * self._level
            self._level += self.weight * (power - self._level)
        self._maps += 1
        return exceeds
