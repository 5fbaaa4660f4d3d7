"""The terrains that the echoes allow: covariances of each smoothness, and how probable each is.

What lies below the footprint the echoes hardly tell, and one covariance, however likely, would state it as if it were
known. So the variance of a height is averaged over the smoothness, as Bayesian model averaging has it (Hoeting et al.
1999): for each smoothness the likeliest length, variance and noise are taken, and it counts as its likelihood, times
the prior. That is even in the logarithm of the smoothness but for a factor (1 + smoothness)^-3, which leans to rough
ground. The exponent is by trial: of 0 to 6, on surveys of four terrains and four beams; 2 and 4 do nearly as well, and
surveys that it was not chosen on agree (`docs/theory/uncertainty.md`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize

from sionna_radar.mapping.covariance import (
    OF_GAUSSIAN,
    Covariance,
    FittedCovariance,
    Measured,
    neighbours,
    posterior_loss,
    search_bounds,
)

# No ground is of the Matern family, and a likelihood that takes it for one is too sure of the smoothness: its logarithm
# counts a third (Miller and Dunson 2019, "Robust Bayesian inference via coarsening").
TEMPERING = 3.0
# The exponent of the prior, and the smoothnesses that are tried: about evenly spaced in their logarithms.
RARER = 3.0
TRIED = (0.3, 0.5, 0.9, 1.6, 3.0, 6.0, np.inf)
# Beyond a smoothness that is less probable than the best by so many nepers, none is tried.
IMPROBABLE = 15.0
# A tenth of a neper of some thousand is enough.
ITERATIONS, TOLERANCE = 12, 1e-4


@dataclass(frozen=True)
class Plausible:
    """A terrain that the echoes allow, and its probability."""

    probability: float
    terrain: FittedCovariance


def plausible_terrains(measured: Measured, fitted: FittedCovariance) -> tuple[Plausible, ...]:
    """Return the terrains that measured heights allow, the most probable first.

    Parameters
    ----------
    measured:
        Scattered heights.
    fitted:
        What was learned from them, where the search begins.

    """
    near = neighbours(measured)
    bounds = search_bounds(measured)[:3]
    taken = fitted.covariance
    first = int(np.argmin(np.abs(np.log(np.minimum(TRIED, OF_GAUSSIAN) / min(taken.smoothness, OF_GAUSSIAN)))))
    found: dict[int, tuple[float, Float[np.ndarray, 3]]] = {}

    def search(numbers: Sequence[int], start: Float[np.ndarray, "3"], onward: Float[np.ndarray, "3"]) -> None:
        for number in numbers:
            smoothness = TRIED[number]
            result = minimize(
                lambda x, nu=smoothness: posterior_loss(x, nu, near),
                np.clip(start + onward, *np.transpose(bounds)),
                jac=True,
                method="L-BFGS-B",
                bounds=bounds,
                options={"maxiter": ITERATIONS, "ftol": TOLERANCE},
            )
            start, onward = result.x, result.x - start
            found[number] = (float(result.fun) + RARER * float(np.log1p(min(smoothness, OF_GAUSSIAN))), result.x)
            if found[number][0] > min(loss for loss, _ in found.values()) + IMPROBABLE:
                return

    search([first], np.log([taken.length_m, taken.variance_m2, fitted.noise_factor]), np.zeros(3))
    search(range(first + 1, len(TRIED)), found[first][1], np.zeros(3))
    search(range(first - 1, -1, -1), found[first][1], np.zeros(3))
    least = min(loss for loss, _ in found.values())
    share = {number: np.exp((least - loss) / TEMPERING) for number, (loss, _) in found.items()}
    every = []
    for number, (_, logarithms) in found.items():
        length, variance, factor = (float(value) for value in np.exp(logarithms))
        terrain = FittedCovariance(Covariance(TRIED[number], length, variance), factor)
        every.append(Plausible(float(share[number] / sum(share.values())), terrain))
    return tuple(sorted(every, key=lambda each: -each.probability))
