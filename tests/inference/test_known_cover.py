"""The land cover that maps of whole echoes know: its cells, its levels, and where there is none."""

import numpy as np
import pytest

from sionna_radar import ScenarioError, load_scenario, prepare, process, run
from sionna_radar.mapping.build import land_cover_of

FIELD = {
    "dem.cover": "known",
    "platform.length_m": 10.0,
    "terrain.material": "dark",
    "terrain.cover": [{"polygon_m": [[-300.0, 3.0], [300.0, 3.0], [300.0, 300.0], [-300.0, 300.0]], "material": "lit"}],
    "materials.dark": {"model": "constant_gamma", "gamma_db": -30.0},
    "materials.lit": {"model": "lambertian", "nadir_sigma0_db": -10.0},
}


def test_a_known_cover_is_that_of_the_scenario():
    mapper = prepare(load_scenario("hills", FIELD)).mapper
    cover = mapper.cover
    assert cover is not None
    assert len(cover.gamma) == 2
    west, east, _, north = mapper.grid.extent_m
    assert cover.grid.extent_m[0] <= west - 20
    assert cover.grid.extent_m[3] >= north + 20
    # In the order of their names.
    expected = np.broadcast_to(cover.grid.y_m[:, None] > 3.0, cover.grid.shape)
    np.testing.assert_array_equal(cover.cover, expected)
    # At 60 deg gamma of Lambert's law is 0.1 cos(60 deg) = 0.05, and that of the other ground 0.001.
    axis = np.array([[np.sin(np.pi / 3), 0.0, -0.5]])
    np.testing.assert_allclose(cover.levels(axis), [[0.02, 1.0]], rtol=5e-3)
    place_m = np.array([[[west, 2.9], [east, 3.1], [1e4, -1e4]]])
    np.testing.assert_array_equal(cover.brightness(place_m, axis), cover.levels(axis)[:, [0, 1, 0]])


def test_covers_are_known_only_where_something_says_so():
    bare = load_scenario("hills", {"dem.cover": "known"})
    with pytest.raises(ScenarioError, match=r"dem\.cover: 'known' needs terrain\.cover"):
        prepare(bare)
    with pytest.raises(ScenarioError, match=r"dem\.cover"):
        land_cover_of(None, prepare(load_scenario("hills")).mapper.grid)


def test_a_recording_is_mapped_with_the_covers_of_its_scenario(tmp_path):
    scenario = load_scenario("hills", FIELD | {"dem.method": "smooth"})
    flown = run(scenario, recordings={"signals": tmp_path / "beats.nc"})
    again = process(tmp_path / "beats.nc").dem
    assert again is not None
    np.testing.assert_array_equal(again.height_m, flown.dem.height_m)
    unknown = process(tmp_path / "beats.nc", {"dem.cover": "unknown"}).comparison
    assert unknown is not None
    # Part of the beams meets dark ground and bright ground beside it.
    assert flown.lit_error.rms_m < 0.97 * unknown.lit_error.rms_m
