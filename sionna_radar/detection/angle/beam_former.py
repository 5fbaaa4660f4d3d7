"""Beam formers of a row of receivers: conventional (Bartlett), minimum variance (Capon), and MUSIC.

The row's signals in a range cell are x = sum a(u) s + noise, a(u) = exp(j k z u) over the places z of the receivers, u
the direction cosine along the row, and R = E[x x^H]. Bartlett's spectrum a^H R a is as sharp as the row is long;
Capon's 1 / a^H R^-1 a and MUSIC's 1 / |E^H a|^2, E the eigenvectors of R without those of the strongest
sources (Stoica and Nehorai 1989, "MUSIC, maximum likelihood, and Cramer-Rao bound", IEEE Trans. ASSP 37), tell nearer
sources apart as their powers exceed the noise. Two ways of one wave are coherent, and R has one source alone; its mean
with that of the row turned around, (R + J R* J) / 2, parts them.

MUSIC stands here in a few lines of NumPy: the libraries at hand are written for studies of other signals, hold single
covariances, and one of them says that it is not designed for real-world applications (doatools).
"""

import numpy as np
from jaxtyping import Complex, Float

# Steps of the direction cosine in a spectrum: so many in the width of the row's own beam.
STEPS_IN_BEAM = 100
# Of the mean power, added to a covariance before it is inverted.
LOADING = 1e-9


def steering(
    place_wavelengths: Float[np.ndarray, " element"], cosine: Float[np.ndarray, " n"]
) -> Complex[np.ndarray, "n element"]:
    """Return what a wave from some direction cosines leaves in receivers at places along a row."""
    vectors: Complex[np.ndarray, "n element"] = np.exp(2j * np.pi * np.outer(cosine, place_wavelengths))
    return vectors


def forward_backward(covariance: Complex[np.ndarray, "*point e e"]) -> Complex[np.ndarray, "*point e e"]:
    """Return covariances of an even row averaged with those of the row turned around."""
    averaged: Complex[np.ndarray, "*point e e"] = (covariance + covariance[..., ::-1, ::-1].conj()) / 2
    return averaged


def bartlett(
    covariance: Complex[np.ndarray, "*point e e"], vectors: Complex[np.ndarray, "n e"]
) -> Float[np.ndarray, "*point n"]:
    """Return the mean power that a beam in each direction receives."""
    return _form(covariance, vectors) / vectors.shape[1] ** 2


def capon(
    covariance: Complex[np.ndarray, "*point e e"], vectors: Complex[np.ndarray, "n e"]
) -> Float[np.ndarray, "*point n"]:
    """Return the least mean power of beams that pass each direction as it is."""
    count = vectors.shape[1]
    level = np.trace(covariance, axis1=-2, axis2=-1).real[..., None, None] / count
    spectrum: Float[np.ndarray, "*point n"] = 1 / _form(
        np.linalg.inv(covariance + LOADING * level * np.eye(count)), vectors
    )
    return spectrum


def noise_share(
    covariance: Complex[np.ndarray, "*point e e"], vectors: Complex[np.ndarray, "n e"], sources: int
) -> Float[np.ndarray, "*point n"]:
    """Return the share of each direction's wave outside the space of the sources: MUSIC's spectrum is its inverse."""
    own = np.linalg.eigh(covariance)[1][..., -sources:]
    inside = np.sum(np.abs(vectors.conj() @ own) ** 2, axis=-1)
    share: Float[np.ndarray, "*point n"] = 1 - inside / vectors.shape[1]
    return share


def scanned(place_wavelengths: Float[np.ndarray, " element"], reach: float) -> Float[np.ndarray, " n"]:
    """Return direction cosines to `reach` on either side, in steps that resolve a row's beam."""
    half = int(np.ceil(reach * float(np.ptp(place_wavelengths)) * STEPS_IN_BEAM)) + 1
    return np.linspace(-reach, reach, 2 * half + 1)


def lowest(
    share: Float[np.ndarray, "point n"], cosine: Float[np.ndarray, " n"], sources: int
) -> Float[np.ndarray, "point source"]:
    """Return where the share outside has its lowest minima, by parabolas through three directions; NaN for none."""
    inner = share[:, 1:-1]
    dip = (inner <= share[:, :-2]) & (inner < share[:, 2:])
    ranked = np.argsort(np.where(dip, inner, np.inf), axis=1, kind="stable")[:, :sources]
    found = np.take_along_axis(dip, ranked, axis=1)
    row = np.arange(len(share))[:, None]
    before, at, after = (share[row, ranked + step] for step in range(3))
    bend = before - 2 * at + after
    shift = np.where(bend > 0, (before - after) / np.where(bend > 0, 2 * bend, 1.0), 0.0)
    place = cosine[1] - cosine[0]
    return np.where(found, cosine[ranked + 1] + np.clip(shift, -0.5, 0.5) * place, np.nan)


def separators(vectors: Complex[np.ndarray, "point source e"]) -> Complex[np.ndarray, "point source e"]:
    """Return the weights that pass each of some sources as it is, and none of the others: rows of a pseudo-inverse."""
    # Of vectors as rows: A = vectors^T, and A^+ = (A^H A)^-1 A^H.
    conjugate = vectors.conj()
    weights: Complex[np.ndarray, "point source e"] = np.linalg.inv(conjugate @ np.swapaxes(vectors, 1, 2)) @ conjugate
    return weights


def source_powers(
    covariance: Complex[np.ndarray, "point e e"],
    vectors: Complex[np.ndarray, "point source e"],
    noise: Float[np.ndarray, " point"],
) -> Float[np.ndarray, "point source"]:
    """Return the powers of sources in known directions, by least squares, not below the noise in one receiver."""
    inverse = separators(vectors)
    clean = covariance - noise[:, None, None] * np.eye(covariance.shape[-1])
    power = np.einsum("pse,pef,psf->ps", inverse, clean, inverse.conj()).real
    return np.maximum(power, noise[:, None])


def cosine_variance(
    place_wavelengths: Float[np.ndarray, " element"],
    vectors: Complex[np.ndarray, "point source e"],
    power_over_noise: Float[np.ndarray, "point source"],
    looks: Float[np.ndarray, " point"],
) -> Float[np.ndarray, "point source"]:
    """Return the variances of direction cosines of uncorrelated sources: the Cramer-Rao bound of strong ones.

    1 / (2 L R h), R the power over the noise and h the squared length of a's derivative outside the space of all
    sources (Stoica and Nehorai 1989; see above).
    """
    derivative = 2j * np.pi * place_wavelengths * vectors
    # The projection onto the sources' space.
    conjugate = vectors.conj()
    gram = np.linalg.inv(conjugate @ np.swapaxes(vectors, 1, 2))
    along = conjugate @ np.swapaxes(derivative, 1, 2)
    inside = np.einsum("pis,pij,pjs->ps", along.conj(), gram, along).real
    outside = np.sum(np.abs(derivative) ** 2, axis=2) - inside
    return 1 / (2 * looks[:, None] * power_over_noise * np.maximum(outside, 1e-12))


def _form(
    matrix: Complex[np.ndarray, "*point e e"], vectors: Complex[np.ndarray, "n e"]
) -> Float[np.ndarray, "*point n"]:
    form: Float[np.ndarray, "*point n"] = np.sum((vectors.conj() @ matrix) * vectors, axis=-1).real
    return form
