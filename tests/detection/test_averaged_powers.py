"""A CFAR over averaged powers: its closed form against the F distribution, and against drawn cells."""

import numpy as np
import pytest
from scipy.linalg import cholesky, toeplitz
from scipy.special import betainc

from sionna_radar.detection.build import build_detector
from sionna_radar.detection.cfar import Cfar
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scenario.processing import ProcessingTable

INDEPENDENT = np.array([1.0])
HANN = np.array([1.0, 2 / 3, 1 / 6, 0.0])


def make_cfar(looks, training=16, pfa=1e-3, correlation=INDEPENDENT) -> Cfar:
    values = {"kind": "CA", "guard": 4, "training": training, "false_alarm_probability": pfa}
    return Cfar(**values, correlation=correlation, looks=looks)


def f_law(factor, cells, looks):
    """Probability that a mean of so many powers passes a multiple of the mean of such cells."""
    # X / (X + Z) of gamma variates with `looks` and `cells * looks` degrees has a beta distribution.
    return betainc(cells * looks, looks, 1 / (1 + factor / cells))


@pytest.mark.parametrize("looks", [1, 2, 5, 32])
@pytest.mark.parametrize("pfa", [1e-2, 1e-6, 1e-11])
def test_independent_cells_have_the_f_distribution(looks, pfa):
    cfar = make_cfar(looks, pfa=pfa)
    assert f_law(cfar.both_sides_factor, 32, looks) == pytest.approx(pfa, rel=1e-6)
    assert f_law(cfar.one_side_factor, 16, looks) == pytest.approx(pfa, rel=1e-6)
    snr = np.array([0.0, 1.0, 10.0])
    expected = f_law(cfar.both_sides_factor / (1 + snr), 32, looks)
    np.testing.assert_allclose(cfar.detection_probability(snr), expected, rtol=1e-6)


@pytest.mark.parametrize("looks", [2, 8])
def test_correlated_cells_pass_as_often_as_drawn_ones(looks):
    cfar = make_cfar(looks, training=8, pfa=1e-2, correlation=HANN)
    random, sides, draws = np.random.default_rng(11), 2, 60_000
    mix = cholesky(toeplitz([*HANN, *np.zeros(4)]) + 1e-9 * np.eye(8), lower=True)
    parts = random.standard_normal((2, draws * looks * sides, 8)) @ mix.T
    power = (parts[0] ** 2 + parts[1] ** 2) / 2
    level = power.reshape(draws, looks * sides * 8).mean(axis=1)
    tested = random.gamma(looks, 1 / looks, draws)
    for snr in (0.0, 1.5):
        found = np.mean((1 + snr) * tested > cfar.both_sides_factor * level)
        expected = cfar.detection_probability(np.array([snr]))[0]
        assert found == pytest.approx(expected, abs=4 * np.sqrt(expected * (1 - expected) / draws))


def test_powers_of_bursts_are_averaged_before_the_threshold():
    """False alarms on noise are as many as specified, and the scatter of powers falls by the number of chirps."""
    chirp = Chirp(carrier_hz=77e9, bandwidth_hz=500e6, rate_hz=4000.0, samples=512, sampling="iq")
    average = {"chirps": 4, "mode": "incoherent"}
    cfar = {"kind": "CA", "guard": 4, "training": 16, "false_alarm_probability": 1e-2}
    detector = build_detector(ProcessingTable(average=average, cfar=cfar, zero_padding=1), chirp)
    random = np.random.default_rng(5)
    parts = random.standard_normal((2, 4 * 400, chirp.samples))
    spectra = detector.spectra((parts[0] + 1j * parts[1]) / np.sqrt(2))
    assert spectra.power.shape == (400, chirp.samples)
    assert np.mean(spectra.power > spectra.threshold) == pytest.approx(1e-2, rel=0.1)
    assert np.var(spectra.power) / np.mean(spectra.power) ** 2 == pytest.approx(1 / 4, rel=0.05)
