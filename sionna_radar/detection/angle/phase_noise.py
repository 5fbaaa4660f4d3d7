"""How well an angle of arrival is known: the Cramer-Rao bound of its phase, and what speckle leaves.

The signals of the receivers in a range cell are sums over many scatterers, complex Gaussian with the coherence gamma.
The phase of the cross-spectrum averaged over L looks has, where that is not few, the variance of its Cramer-Rao bound
(Rodriguez and Martin 1992, "Theory and design of interferometric synthetic aperture radars"; Seymour and Cumming 1994)

    var(phi) = (1 - gamma^2) / (2 L gamma^2).

Two receivers beside one first have correlated phases; of the second moments of complex Gaussian variables (Goodman
2007, "Speckle Phenomena in Optics", app. A) follows

    cov(phi_i, phi_j) = (Re(c_ij c_00 / (c_i0 c_0j)) - 1) / (2 L).

Over a Gaussian strip, along which the phases grow by a_i and a_j a standard deviation, the ratio is exp(a_i a_j): the
phases of both scatter together, as the mean direction of a speckled strip wanders along it. That does no harm, because
the ground is there: across the strip, where an error lifts a point off the ground, a_i c_i + a_j c_j vanishes, and only
noise and terms of second order in a are left.
"""

import numpy as np
from jaxtyping import Float


def phase_covariance(
    along_rad: Float[np.ndarray, "point receiver"],
    snr: Float[np.ndarray, " point"],
    looks: Float[np.ndarray, " point"],
) -> Float[np.ndarray, "point receiver receiver"]:
    """Return the covariance of the phases of side receivers against the first.

    Parameters
    ----------
    along_rad:
        Standard deviation of each receiver's phase along the strip.
    snr:
        Power of the echo over that of the noise in each receiver, a ratio.
    looks:
        Independent looks.

    """
    noise = 1 / snr
    both = np.exp(along_rad[:, :, None] * along_rad[:, None, :])
    own = np.eye(along_rad.shape[1]) * (noise[:, None] * np.exp(along_rad**2))[:, :, None]
    ratio = (both + own) * (1 + noise)[:, None, None]
    return (ratio - 1) / (2 * looks)[:, None, None]


def coherence(along_rad: Float[np.ndarray, "..."], snr: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Return the coherence of two receivers over a strip, with noise in both."""
    found: Float[np.ndarray, ...] = np.exp(-(along_rad**2) / 2) * snr / (1 + snr)
    return found


def phase_variance(
    coherent: Float[np.ndarray, "..."], looks: Float[np.ndarray, "..."] | float
) -> Float[np.ndarray, "..."]:
    """Return the Cramer-Rao bound of the variance of the phase of a cross-spectrum, in rad^2.

    Examples
    --------
    >>> import numpy as np
    >>> round(float(np.sqrt(phase_variance(np.array(0.9), 16.0))), 4)  # rad
    0.0856

    """
    found: Float[np.ndarray, ...] = (1 - coherent**2) / (2 * np.asarray(looks) * coherent**2)
    return found


def ratio_covariance(
    ratio: Float[np.ndarray, "point receiver node"],
    share: Float[np.ndarray, " node"],
    snr: Float[np.ndarray, " point"],
    looks: Float[np.ndarray, " point"],
) -> Float[np.ndarray, "point receiver receiver"]:
    """Return the covariance of measured ratios of difference and sum.

    A ratio is the mean over the strip's scatterers, weighted by a speckled field, and half of that field's variance is
    in phase with the sum.

    Parameters
    ----------
    ratio, share:
        Ratios at places along the strip, and their shares of its power.
    snr, looks:
        See `phase_covariance`; the noise of the difference is that of the sum.

    """
    apart = ratio - np.sum(ratio * share, axis=2, keepdims=True)
    spread = np.einsum("pin,pjn,n->pij", apart, apart, share)
    noise = np.eye(ratio.shape[1]) * (1 + np.sum(ratio * share, axis=2) ** 2)[:, :, None] / snr[:, None, None]
    return (spread + noise) / (2 * looks)[:, None, None]
