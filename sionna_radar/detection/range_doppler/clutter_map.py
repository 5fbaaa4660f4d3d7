"""Clutter-map CFAR: each cell against what it held in earlier maps.

The level of a cell is an exponential mean of its power in earlier maps, Z_n = (1 - w) Z_(n-1) + w P_(n-1). Still
ground, whatever its power, is not detected; what comes newly is. In noise or in clutter of exponential power, new in
each map, the false-alarm rate after many maps is (Nitzberg 1986, "Clutter map CFAR analysis", IEEE Trans. Aerosp.
Electron. Syst. 22)

    P = prod_(k >= 0) 1 / (1 + a w (1 - w)^k),

and after n maps, the first of which is the first level, 1 / (1 + a (1 - w)^(n - 1)) takes the place of the rest: so the
threshold is right from the second map on.
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float

from sionna_radar.detection.false_alarm import factor_of_mean
from sionna_radar.foundation.errors import Problem, ScenarioError

# Weights of earlier maps below this are left out of the factor.
LEAST_SHARE = 1e-9


@dataclass(kw_only=True)
class ClutterMap:
    """Keeps the level of every cell of maps that follow each other.

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
    _level: Float[np.ndarray, "rate bin"] | None = field(default=None, repr=False)
    _maps: int = 0

    def __post_init__(self) -> None:
        if not 0 < self.weight < 1:
            raise ScenarioError([Problem("weight", f"{self.weight:g} is no share; give one between 0 and 1")])

    @property
    def factor(self) -> float:
        """Multiple of the level that a cell of the next map must exceed; infinite before the first."""
        if self._maps == 0:
            return np.inf
        return factor_of_mean(self._shares(), 1, self.false_alarm_probability)

    def _shares(self) -> Float[np.ndarray, " map"]:
        """Return the shares of earlier maps in the level, the latest first."""
        enough = int(np.ceil(np.log(LEAST_SHARE) / np.log(1 - self.weight)))
        kept = (1 - self.weight) ** np.arange(min(self._maps, enough))
        shares = self.weight * kept
        if self._maps <= enough:
            shares[-1] = kept[-1]  # of the first map, which was the first level
        return shares

    def detected(self, power: Float[np.ndarray, "rate bin"]) -> Bool[np.ndarray, "rate bin"]:
        """Mark the cells of a map that exceed their threshold, and add it to the levels of those that follow."""
        if self._level is None:
            self._level = power.copy()
            found = np.zeros(power.shape, dtype=bool)
        else:
            found = power > self.factor * self._level
            self._level += self.weight * (power - self._level)
        self._maps += 1
        return found
