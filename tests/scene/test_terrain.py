import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import CRS, Transformer
from scipy.special import j0

from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.scenario import load_scenario
from sionna_radar.scenario.terrain import FlatTerrain, FractalTerrain, HillsTerrain, SampleTerrain
from sionna_radar.scene.model import mesh_of
from sionna_radar.survey.preparation import prepare
from worlds import load_ground

WINDOW = (-50.0, -50.0, 50.0, 50.0)


def raster_of(height):
    rows, columns = height.shape
    return Raster(grid=Grid(west_m=-3.0, south_m=2.0, spacing_m=0.5, columns=columns, rows=rows), height_m=height)


def test_flat_ground_has_its_size_about_the_origin():
    raster, place = load_ground(FlatTerrain(kind="flat", size_m=(300.0, 70.0), spacing_m=5.0), WINDOW)
    assert place is None
    assert (raster.height_m == 0).all()
    vertices, _ = mesh_of(raster)
    np.testing.assert_allclose(vertices.min(axis=0), [-150, -35, 0])
    np.testing.assert_allclose(vertices.max(axis=0), [150, 35, 0])


@pytest.mark.parametrize(("size", "spacing", "columns"), [(1.1, 0.1, 12), (1.0, 0.3, 5), (3.0, 2.0, 3)])
def test_flat_ground_is_never_smaller_than_asked(size, spacing, columns):
    raster, _ = load_ground(FlatTerrain(kind="flat", size_m=(size, 20.0), spacing_m=spacing), WINDOW)
    assert raster.grid.columns == columns
    assert -raster.grid.x_m[0] == pytest.approx(raster.grid.x_m[-1])
    assert raster.grid.x_m[-1] >= size / 2 - 1e-9


def hills(**fields):
    return load_ground(HillsTerrain(kind="hills", **{"spacing_m": 2.0, **fields}), WINDOW)[0]


def test_hills_reach_from_zero_to_their_height_and_repeat_by_seed():
    raster = hills(height_m=12.0, seed=5)
    assert raster.height_m.min() == 0
    assert raster.height_m.max() == pytest.approx(12.0, rel=1e-12)
    np.testing.assert_array_equal(raster.height_m, hills(height_m=12.0, seed=5).height_m)
    assert np.abs(raster.height_m - hills(height_m=12.0, seed=6).height_m).max() > 1


def test_hills_have_the_correlation_of_their_filter():
    # White noise under a Gaussian of width s has the autocorrelation exp(-d^2 / (4 s^2)).
    height = hills(size_m=(2000.0, 2000.0), filter_sigma_m=10.0).height_m
    height = height - height.mean()
    lag = 7
    correlation = (height[:, lag:] * height[:, :-lag]).mean() / (height**2).mean()
    assert correlation == pytest.approx(np.exp(-((lag * 2.0) ** 2) / (4 * 10.0**2)), abs=0.03)


@pytest.mark.parametrize("hurst", [0.3, 0.6, 0.9])
def test_fractal_ground_is_self_affine(hurst):
    variance = np.zeros(2)
    for seed in range(6):
        ground = FractalTerrain(kind="fractal", hurst=hurst, size_m=(511.0, 511.0), spacing_m=1.0, seed=seed)
        height = load_ground(ground, WINDOW)[0].height_m
        assert (height.min(), height.max()) == pytest.approx((0.0, 10.0))
        scale = np.std(height)
        for place, lag in enumerate((5, 20)):
            variance[place] += np.mean(((height[lag:] - height[:-lag]) / scale) ** 2)
    # Between the wavenumbers of the size and of the cell.
    k = np.geomspace(2 * np.pi / 511, np.pi, 4000)
    expected = [np.trapezoid((1 - j0(k * lag)) * k ** -(2 * hurst + 1), k) for lag in (5, 20)]
    assert variance[1] / variance[0] == pytest.approx(expected[1] / expected[0], rel=0.1)


def test_hills_are_alike_at_the_border_and_in_the_middle():
    border, middle = [], []
    for seed in range(60):
        height = hills(size_m=(200.0, 200.0), filter_sigma_m=8.0, seed=seed).height_m
        slope = np.diff(height, axis=0)
        border.append((slope[:, 0] ** 2).mean())
        middle.append((slope[:, 50] ** 2).mean())
    assert np.mean(border) == pytest.approx(np.mean(middle), rel=0.15)


def test_synthetic_ground_that_cannot_be_built_is_refused():
    with pytest.raises(ScenarioError, match=r"terrain\.spacing_m: 0\.001 .*raise it"):
        load_ground(FlatTerrain(kind="flat", spacing_m=0.001), WINDOW)
    with pytest.raises(ScenarioError, match=r"terrain\.filter_sigma_m: 500 .*lower it"):
        hills(filter_sigma_m=500.0)


def test_jacksboro_lies_where_its_summit_lies():
    # Cross Mountain, Tennessee: 36 deg 11' 54" N, 84 deg 13' 50" W, 3534 ft (USGS).
    summit = (-(84 + 13 / 60 + 50 / 3600), 36 + 11 / 60 + 54 / 3600)
    terrain = SampleTerrain(kind="jacksboro", centre_lonlat_deg=summit)
    raster, place = load_ground(terrain, (-2000.0, -2000.0, 2000.0, 2000.0))
    assert place is not None
    assert [part.to_epsg() for part in CRS(place.crs_wkt).sub_crs_list] == [32616, 5773]
    highest = raster.grid.centres_m[np.argmax(raster.height_m)]
    assert np.hypot(*highest) < 120
    assert raster.height_m.max() + place.origin_m[2] == pytest.approx(3534 * 0.3048, abs=8)


def test_jacksboro_town_is_about_the_middle_of_the_tile():
    raster, place = load_ground(SampleTerrain(kind="jacksboro"), (-20e3, -20e3, 20e3, 20e3))
    assert place is not None
    assert 70 < raster.grid.spacing_m < 80
    to_local = Transformer.from_crs(4326, CRS(place.crs_wkt), always_xy=True)
    east, north = to_local.transform(-84.1839, 36.3301)
    point = np.array([[east - place.origin_m[0], north - place.origin_m[1]]])
    # USGS gives 1,066 ft.
    assert raster.at(point)[0] + place.origin_m[2] == pytest.approx(325, abs=8)


@settings(max_examples=50)
@given(rows=st.integers(2, 9), columns=st.integers(2, 9), seed=st.integers(0, 2**32), share=st.floats(0, 0.6))
def test_meshes_cover_exactly_the_squares_between_filled_cells(rows, columns, seed, share):
    rng = np.random.default_rng(seed)
    height = rng.normal(size=(rows, columns))
    height[rng.random(height.shape) < share] = np.nan
    raster = raster_of(height)
    vertices, faces = mesh_of(raster)

    squares = sum(
        bool(np.isfinite(height[i : i + 2, j : j + 2]).all()) for i in range(rows - 1) for j in range(columns - 1)
    )
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    twice_area = np.cross(b - a, c - a)[:, 2]
    np.testing.assert_allclose(twice_area, raster.grid.spacing_m**2)
    assert len(faces) == 2 * squares
    assert set(np.unique(faces)) == set(range(len(vertices)))
    cell = np.rint((vertices[:, :2] - [raster.grid.west_m, raster.grid.south_m]) / raster.grid.spacing_m)
    np.testing.assert_array_equal(height[cell[:, 1].astype(int), cell[:, 0].astype(int)], vertices[:, 2])


def test_synthetic_ground_may_have_a_place_on_the_map() -> None:
    overrides = {"terrain.centre_lonlat_deg": [11.0, 47.0], "platform.length_m": 10.0}
    placed = prepare(load_scenario("hills", {**overrides, "coordinates": "lonlat", "platform.start_m": [11.0, 47.0]}))
    georeference = placed.world.scene.georeference
    assert georeference is not None
    assert CRS.from_wkt(georeference.crs_wkt).to_epsg() == 32632
    to_map = Transformer.from_crs(4326, 32632, always_xy=True)
    assert georeference.origin_m[:2] == pytest.approx(to_map.transform(11.0, 47.0), abs=1e-6)
    assert placed.local.platform.start_m == pytest.approx((0.0, 0.0), abs=1e-6)


def test_map_coordinates_need_a_place() -> None:
    with pytest.raises(ScenarioError, match="needs terrain with a place on the map, which 'hills' does not have"):
        load_scenario("hills", {"coordinates": "lonlat", "platform.start_m": [11.0, 47.0]})
