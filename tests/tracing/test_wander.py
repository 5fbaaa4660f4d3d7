"""Surfaces that move: the echo's field loses its correlation with itself as stated, whichever engine traces it."""

from dataclasses import replace

import numpy as np
import pytest

from beams import make_antenna, make_chirp
from flights import make_pulses
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.scenario import load_scenario
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.tracing.engines.gamma.facets import GammaEngine
from sionna_radar.tracing.engines.persistent.persistent import PersistentEngine
from sionna_radar.tracing.paths import wander_hz
from worlds import make_scene, make_surface

TIME_S = 0.03
LAGS = np.array([0.0, 0.5, 1.0, 2.0, 5.0])


@pytest.fixture(scope="module", params=["sionna", "gamma"])
def engine(request):
    ground = make_scene(make_surface(lambda x, y: 0 * x, size_m=200.0, spacing_m=2.0))
    antenna, chirp = make_antenna(8.0, 8.0), make_chirp()
    if request.param == "sionna":
        return PersistentEngine(ground, antenna, chirp, 1, 40.0, decorrelation_time_s=TIME_S)
    return GammaEngine(ground, antenna, chirp, 1, RayCaster(ground.surfaces), decorrelation_time_s=TIME_S)


def correlation(engine, lags: np.ndarray) -> np.ndarray:
    """Correlation of the paths of some poses, place by place, with those some decorrelation times later."""
    power, products = 0.0, np.zeros(len(lags))
    for east in np.arange(-60.0, 61.0, 10.0):
        pulses = make_pulses(len(lags), incidence_deg=30.0, position_m=(east, -30.0, 50.0))
        paths = engine.trace(replace(pulses, time_s=100.0 + lags * TIME_S))
        # The rays beside the beam meet other places each time.
        _, place, times = np.unique(paths.hit_m, axis=0, return_inverse=True, return_counts=True)
        lasting = times[place] == len(lags)
        fields = [paths.gain[lasting & (paths.pulse == index)] for index in pulses.index]
        products += (np.array(fields) @ np.conj(fields[0])).real
        power += np.sum(np.abs(fields[0]) ** 2)
    return products / power


def test_the_field_loses_its_correlation_as_a_two_sided_exponential_spectrum_does(engine):
    """1 / (1 + (b t)^2), which is 1 / e after the decorrelation time (Billingsley's spectrum of windblown plants)."""
    expected = 1 / (1 + (np.e - 1) * LAGS**2)
    assert expected[2] == pytest.approx(1 / np.e)
    np.testing.assert_allclose(correlation(engine, LAGS), expected, atol=0.05)


def test_the_mean_shift_follows_from_the_time():
    assert 1 / (1 + (2 * np.pi * wander_hz(TIME_S) * TIME_S) ** 2) == pytest.approx(1 / np.e)


def test_speckle_that_is_drawn_anew_has_nothing_to_lose():
    with pytest.raises(ScenarioError, match=r"tracing\.decorrelation_time_s"):
        load_scenario("hills", {"tracing.speckle": "per_pulse", "tracing.decorrelation_time_s": 0.1})
    with pytest.raises(ScenarioError, match=r"tracing\.decorrelation_time_s"):
        load_scenario("hills", {"tracing.engine": "path_solver", "tracing.decorrelation_time_s": 0.1})


def test_the_stock_solver_draws_anew_without_being_told():
    assert load_scenario("hills", {"tracing.engine": "path_solver"}).tracing.speckle == "per_pulse"
    assert load_scenario("hills").tracing.speckle == "persistent"
