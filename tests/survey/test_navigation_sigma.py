"""Heights moved by stated errors of navigation: against the same survey flown with many drawn errors."""

import numpy as np
import pytest

from sionna_radar.foundation.raster import Raster
from sionna_radar.mapping.linear.gridding import grid_points
from sionna_radar.scenario import load_scenario
from sionna_radar.survey.observed_survey import observe_survey
from sionna_radar.survey.placement import navigation_sigma

FLIGHT = {"platform.length_m": 24.0, "terrain.kind": "hills"}


@pytest.fixture(scope="module")
def recorded():
    return observe_survey(load_scenario("hills", FLIGHT))


@pytest.mark.parametrize(
    "errors",
    [
        {"position_markov_m": (0.3, 0.2, 0.1)},
        {"attitude_markov_deg": (0.5, 0.3, 0.8)},
        {"velocity_markov_mps": 0.3},
    ],
    ids=["position", "attitude", "velocity"],
)
def test_drawn_errors_move_heights_as_stated(recorded, errors):
    table = type(recorded.prepared.local.platform.navigation)(**errors)
    prepared = recorded.prepared

    def mapped(navigation):
        flown = prepared.with_navigation(navigation)
        points = recorded.points(navigation)
        mapper = flown.mapper
        return flown, points, grid_points(points, mapper.grid, mapper.max_gap_m, mapper.shadow_incidence_rad).dem

    exact = mapped(None)[2]
    moved = []
    for seed in range(10):
        flown, points, dem = mapped(recorded.navigation(table, seed))
        moved.append(dem.height_m - exact.height_m)
    stated = navigation_sigma(dem, points, flown.flight, flown.mapper.analyser.chirp, doppler_corrected=True)
    both = np.isfinite(moved).all(axis=0)
    seen = np.sqrt(np.mean(np.square(moved)[:, both]))
    assert np.sqrt(np.mean(stated.height_m[both & stated.filled] ** 2)) == pytest.approx(seen, rel=0.35)


def test_an_exact_pose_states_nothing(recorded):
    prepared = recorded.prepared
    points = recorded.points(None)
    dem = Raster(grid=prepared.mapper.grid, height_m=np.zeros(prepared.mapper.grid.shape))
    assert navigation_sigma(dem, points, prepared.flight, prepared.mapper.analyser.chirp, True) is None
