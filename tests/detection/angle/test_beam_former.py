"""Beam formers: two scatterers in one cell, how near they may lie, and MUSIC's variance against the bound."""

import numpy as np
import pytest
from scipy.signal import find_peaks

from sionna_radar.detection.angle.row import (
    cosine_variance,
    forward_backward,
    lowest,
    noise_share,
    scanned,
    source_powers,
    steering,
)

PLACE = np.arange(8) * 1.0
APART = np.array([-0.045, 0.05])
SCANNED = scanned(PLACE, 0.2)


def covariances(cosine, power, looks, trials, seed=1, noise_w=1.0):
    """Sample covariances of uncorrelated sources in noise."""
    random = np.random.default_rng(seed)

    def drawn(*shape):
        return (random.standard_normal(shape) + 1j * random.standard_normal(shape)) / np.sqrt(2)

    source = drawn(trials, looks, len(cosine)) * np.sqrt(power)
    x = source @ steering(PLACE, np.asarray(cosine)) + np.sqrt(noise_w) * drawn(trials, looks, len(PLACE))
    return np.einsum("tle,tlf->tef", x, x.conj()) / looks


def exact(cosine, power, noise_w=1.0):
    vectors = steering(PLACE, np.asarray(cosine))
    return np.einsum("s,se,sf->ef", np.asarray(power), vectors, vectors.conj()) + noise_w * np.eye(len(PLACE))


def formed(matrix, vectors):
    return np.sum((vectors.conj() @ matrix) * vectors, axis=-1).real


def bartlett(covariance, vectors):
    """The mean power that a beam in each direction receives."""
    return formed(covariance, vectors) / vectors.shape[1] ** 2


def capon(covariance, vectors):
    """The least mean power of beams that pass each direction as it is."""
    return 1 / formed(np.linalg.inv(covariance), vectors)


def peaks(spectrum):
    return SCANNED[find_peaks(spectrum)[0]]


def test_a_single_wave_has_its_power_and_its_direction():
    vectors, covariance = steering(PLACE, SCANNED), exact([0.03], [50.0])
    at = np.argmin(np.abs(SCANNED - 0.03))
    for former in (bartlett, capon):
        spectrum = former(covariance, vectors)
        assert abs(SCANNED[np.argmax(spectrum)] - 0.03) < 0.01
        assert former(covariance, steering(PLACE, np.array([0.03])))[0] == pytest.approx(50.0 + 1 / 8, rel=1e-6)
    # Bartlett's beam is the row's own: sin(N x) / (N sin x), here at its half.
    x = np.pi * (SCANNED - 0.03)
    own = (np.sin(8 * x) / (8 * np.sin(x))) ** 2
    np.testing.assert_allclose(bartlett(covariance, vectors), 50.0 * own + 1 / 8, rtol=1e-9)
    assert at > 0


def test_two_nearer_than_the_beam_are_told_apart_by_capon_and_music():
    """0.095 apart, in a beam of 1 / 8: one hump of the conventional one."""
    vectors, covariance = steering(PLACE, SCANNED), exact(APART, [100.0, 100.0])
    assert len(peaks(bartlett(covariance, vectors))[np.abs(peaks(bartlett(covariance, vectors))) < 0.1]) == 1
    np.testing.assert_allclose(peaks(capon(covariance, vectors)), APART, atol=0.01)
    found = np.sort(lowest(noise_share(covariance[None], vectors, 2), SCANNED, 2)[0])
    np.testing.assert_allclose(found, APART, atol=2e-4)


def test_coherent_ones_are_parted_by_the_row_turned_around():
    """Two ways of one wave: the covariance has one source alone, until the row is turned around."""
    vectors = steering(PLACE, APART)
    wave = 10.0 * (vectors[0] + 1j * vectors[1])
    covariance = np.outer(wave, wave.conj()) + np.eye(8)
    assert np.sum(np.linalg.eigvalsh(covariance) > 10) == 1
    parted = forward_backward(covariance)
    assert np.sum(np.linalg.eigvalsh(parted) > 10) == 2
    found = np.sort(lowest(noise_share(parted[None], steering(PLACE, SCANNED), 2), SCANNED, 2)[0])
    np.testing.assert_allclose(found, APART, atol=2e-4)


@pytest.mark.parametrize(("cosine", "power"), [([0.021], [30.0]), (APART, [300.0, 100.0])])
def test_the_variance_is_that_of_the_bound(cosine, power):
    looks, trials = 32, 600
    covariance = covariances(cosine, power, looks, trials)
    found = np.sort(lowest(noise_share(covariance, steering(PLACE, SCANNED), len(power)), SCANNED, len(power)), axis=1)
    error = found - np.sort(cosine)
    bound = cosine_variance(
        PLACE, steering(PLACE, np.asarray(cosine))[None], np.array([power]), np.array([float(looks)])
    )[0]
    assert np.isfinite(found).all()
    np.testing.assert_array_less(np.abs(error.mean(axis=0)), 5 * np.sqrt(bound / trials))
    ratio = error.var(axis=0) / bound
    # MUSIC reaches the bound of strong sources; weaker ones add a share of 1 / N R.
    assert np.all((ratio > 0.85) & (ratio < 1.25))
    if len(power) == 1:
        # Of one source in a row of N spaced d: 6 / (L R (k d)^2 N (N^2 - 1)).
        assert bound[0] == pytest.approx(6 / (looks * power[0] * (2 * np.pi) ** 2 * 8 * 63), rel=1e-9)


def test_powers_of_sources_are_known_where_they_stand():
    covariance = exact(APART, [40.0, 7.0])[None]
    found = source_powers(covariance, steering(PLACE, APART)[None], np.array([1.0]))
    np.testing.assert_allclose(found[0], [40.0, 7.0], rtol=1e-9)


def test_a_source_that_is_not_there_is_not_a_number():
    """A share that falls all the way has no minimum."""
    assert np.isnan(lowest(np.linspace(1.0, 0.0, 9)[None], np.linspace(-1.0, 1.0, 9), 2)).all()
