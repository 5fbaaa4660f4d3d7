"""The phase between receivers against its Cramer-Rao bound, over speckle drawn anew."""

import numpy as np
import pytest

from sionna_radar.detection.angle.arrival import coherence, phase_covariance, ratio_covariance

TRIALS, SCATTERERS = 2000, 24


def signals(rng, looks: int, along: tuple[float, ...], snr: float, factor=lambda x: np.exp(1j * x)):
    """Return the signals of a first receiver and of some beside it, over strips of Gaussian scatterers."""

    def normal(*shape):
        return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)

    place = rng.standard_normal((TRIALS, looks, SCATTERERS))
    field = normal(TRIALS, looks, SCATTERERS) / np.sqrt(SCATTERERS)
    first = field.sum(axis=2) + normal(TRIALS, looks) / np.sqrt(snr)
    sides = [(field * factor(a * place)).sum(axis=2) + normal(TRIALS, looks) / np.sqrt(snr) for a in along]
    return first, sides


@pytest.mark.parametrize("along", [0.0, 0.5], ids=["a point", "a strip"])
@pytest.mark.parametrize("snr", [10.0, 300.0])
def test_the_phase_reaches_its_bound(along, snr):
    looks = 16.0
    first, (side,) = signals(np.random.default_rng(1), int(looks), (along,), snr)
    phase = np.angle(np.sum(side * first.conj(), axis=1))
    coherent = coherence(np.array([along]), np.array([snr]))[0]
    bound = (1 - coherent**2) / (2 * looks * coherent**2)  # Cramer and Rao's, of a cross-spectrum
    # 2000 trials know a variance to 3.2 %; with 16 looks the phase is a little above its bound.
    assert 0.9 < np.var(phase) / bound < 1.25
    stated = phase_covariance(np.array([[along]]), np.array([snr]), np.array([float(looks)]))[0, 0, 0]
    assert stated == pytest.approx(float(bound), rel=1e-12)


def test_two_receivers_err_together_along_the_strip_and_little_across_it():
    along, snr, looks = (0.4, -0.3), 1000.0, 48
    first, sides = signals(np.random.default_rng(2), looks, along, snr)
    phase = np.stack([np.angle(np.sum(side * first.conj(), axis=1)) for side in sides])
    stated = phase_covariance(np.array([along]), np.array([snr]), np.array([float(looks)]))[0]
    np.testing.assert_allclose(np.cov(phase), stated, rtol=0.2)
    across = np.array([0.3, 0.4])
    measured = np.var(across @ phase)
    assert measured == pytest.approx(across @ stated @ across, rel=0.25)
    assert measured < 0.03 * np.var(phase[0])


def test_ratios_of_difference_and_sum_scatter_as_stated():
    snr, looks, along = 200.0, 48, 0.2
    rng = np.random.default_rng(3)
    first, (side,) = signals(rng, looks, (along,), snr, factor=lambda x: np.tan(x + 0.1))
    ratio = np.sum((side * first.conj()).real, axis=1) / (np.sum(np.abs(first) ** 2, axis=1) - looks / snr)
    place, share = np.polynomial.hermite_e.hermegauss(7)
    of_place = np.tan(0.1 + along * place)[None, None]
    stated = ratio_covariance(of_place, share / share.sum(), np.array([snr]), np.array([float(looks)]))[0, 0, 0]
    # Fewer looks than infinitely many scatter the ratio a little more than its first order.
    assert np.var(ratio) == pytest.approx(stated, rel=0.25)
