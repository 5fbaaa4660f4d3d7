"""Robust standard deviations of least squares with spatially correlated errors of unknown correlation length.

Data are cut into a few large blocks, equally full. What is estimated without one of them, each in turn, scatters as the
estimate does (the jackknife over clusters: Tukey 1958; CV3 of MacKinnon, Nielsen and Webb 2023, "Leverage, influence,
and the jackknife in clustered regression models", Stata Journal 23, 942-982). Unlike sums of residuals it does not
suffer from a fit that follows the errors of its own data, nor from blocks with much of the leverage.

Blocks must be wider than the correlation length of the errors. The errors of a DEM follow its relief, of which a
survey sees little: a length estimated from the residuals is too short, and blocks of some such lengths are not
independent. So there are few blocks, as wide as the survey allows, and their small number is part of the answer: an
estimate over its standard deviation has Student's distribution with one degree of freedom less than there are blocks
(Bester, Conley and Hansen 2011, "Inference with dependent data using cluster covariance estimators", Journal of
Econometrics 165, 137-151).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.special import ndtri, stdtrit

# How often data are halved. Chosen on hills and ridges, 30 surveys each by three methods: intervals of 95 % held 92 to
# 98 % with 8 blocks, 89 to 97 % with 16.
HALVINGS = 3
BLOCKS = 2**HALVINGS


@dataclass(frozen=True)
class RobustFit:
    """Parameters, and standard deviations such that 1.96 of them to either side are an interval of 95 %."""

    estimate: Float[np.ndarray, " parameter"]
    sigma: Float[np.ndarray, " parameter"]


def blocks_of(place: Float[np.ndarray, "n axis"]) -> Int[np.ndarray, " n"]:
    """Return the block of each place: halves along the longer extent, of the same number of places, and so on."""
    block = np.zeros(len(place), dtype=np.int64)
    for _ in range(HALVINGS):
        finer = 2 * block
        for number in range(int(block.max(initial=0)) + 1):
            members = np.flatnonzero(block == number)
            if len(members) > 1:
                axis = int(np.argmax(np.ptp(place[members], axis=0)))
                finer[members[np.argsort(place[members, axis], kind="stable")[len(members) // 2 :]]] += 1
        block = finer
    return block


def robust_fit(
    model: Float[np.ndarray, "n parameter"],
    instruments: Float[np.ndarray, "n parameter"],
    data: Float[np.ndarray, " n"],
    block: Int[np.ndarray, " n"],
) -> RobustFit:
    """Return (Z'X)^-1 Z'y of a model X, instruments Z (X itself for least squares) and data y, with its errors.

    block: of each row; errors are independent between blocks only. The standard deviations are infinite where the model
    is singular, as over a plane, or becomes so without one of the blocks.
    """
    size = np.outer(np.linalg.norm(instruments, axis=0), np.linalg.norm(model, axis=0))
    count, parameters = int(block.max()) + 1, model.shape[1]
    products, sums = np.zeros((count, parameters, parameters)), np.zeros((count, parameters))
    for row in range(parameters):
        sums[:, row] = np.bincount(block, instruments[:, row] * data, minlength=count)
        for column in range(parameters):
            products[:, row, column] = np.bincount(block, instruments[:, row] * model[:, column], minlength=count)
    whole = products.sum(axis=0)
    estimate = np.linalg.pinv(whole) @ sums.sum(axis=0)
    without = whole - products
    if (
        size.min() == 0
        or count < 2
        or np.linalg.matrix_rank(np.stack([whole, *without]) / size, tol=1e-9).min() < parameters
    ):
        return RobustFit(estimate, np.full(parameters, np.inf))
    each = np.linalg.solve(without, (sums.sum(axis=0) - sums)[..., None])[..., 0]
    variance = (count - 1) / count * np.sum((each - estimate) ** 2, axis=0)
    wider = float(stdtrit(count - 1, 0.975) / ndtri(0.975))
    return RobustFit(estimate, wider * np.sqrt(variance))
