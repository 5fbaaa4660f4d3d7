"""Crops: rows, gaps and single plants as cells, on slopes and terraces, and what no field is."""

import numpy as np
import pytest

from sionna_radar import CustomParts
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.scenario import parse_scenario
from sionna_radar.scenario.crops import CROPS
from sionna_radar.survey.preparation import prepare

FIELD = [[-20, -20], [20, -20], [20, 20], [-20, 20]]
INSIDE = Grid(west_m=-15.0, south_m=-15.0, spacing_m=1.5, columns=21, rows=21)


def field(altitude_m=30.0, scenario=(), **crop):
    crop = {"kind": "crop", "crop": "maize", "stage": "stem_elongation", "polygon_m": FIELD} | crop
    return parse_scenario(
        {
            "terrain": {"kind": "flat", "size_m": [200.0, 200.0]},
            "platform": {"altitude_m": altitude_m, "speed_mps": 5.0, "length_m": 10.0},
            "radar": {"snr_db": 30.0, "scan": {"mode": "fixed", "incidence_deg": 0.0}},
            "vegetation": [{name: value for name, value in crop.items() if value is not None}],
        }
        | dict(scenario)
    )


def grown(custom=None, **crop):
    return prepare(field(**crop), custom or CustomParts()).world.scene.vegetation


@pytest.mark.parametrize("row_heading_deg", [0.0, 90.0, 37.0])
def test_rows_cover_their_share_and_single_plants_are_of_all_heights(row_heading_deg):
    cover = grown(row_heading_deg=row_heading_deg, missing=0.1)
    assert cover.grid.spacing_m <= 0.15
    assert cover.fraction_over(INSIDE).mean() == pytest.approx(0.9 * 0.6 / 0.75, abs=0.02)
    plants = cover.plant_m[np.isfinite(cover.plant_m)]
    assert plants.mean() == pytest.approx(1.1, abs=0.01)
    assert plants.std() == pytest.approx(0.07 * 1.1, rel=0.1)
    assert np.nanmin(cover.mean_over(INSIDE)) > 1.0
    assert np.all(np.isneginf(cover.bottom_m))


def test_rows_run_along_their_heading():
    """To the north: what is east of the middle of a row by less than half of its width is plants, all along it."""
    cover = grown(row_heading_deg=0.0, height_spread=0.0)
    east_m = np.linspace(-15, 15, 4001)
    off_m = np.abs(east_m - 0.75 * np.round(east_m / 0.75))
    for north_m in (-7.33, 0.0, 11.1):
        stands = np.isfinite(cover.at(np.column_stack([east_m, np.full(4001, north_m)])))
        assert np.all(stands[off_m < 0.2])
        assert not np.any(stands[off_m > 0.361])
    across = grown(row_heading_deg=90.0, height_spread=0.0)
    turned = across.at(np.column_stack([0 * east_m, east_m])), cover.at(np.column_stack([east_m, 0 * east_m]))
    assert np.mean(np.isfinite(turned[0]) != np.isfinite(turned[1])) < 0.15  # a cell on either side of each row


def test_plants_are_drawn_by_the_seed_and_stay_where_they_are():
    first, again, other = (grown(missing=0.3, scenario={"seed": seed}.items()).plant_m for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.mean(np.isfinite(first) != np.isfinite(other)) > 0.2
    corner = [[0, 0], [20, 0], [20, 20], [0, 20]]
    part = grown(missing=0.3, polygon_m=corner)
    whole = grown(missing=0.3)
    places = np.stack(np.meshgrid(np.arange(1, 19, 0.37), np.arange(1, 19, 0.41)), -1).reshape(-1, 2)
    # Of the same cells: both grids are of the same spacing and offset.
    assert part.grid.spacing_m == whole.grid.spacing_m
    np.testing.assert_array_equal(part.at(places), whole.at(places))


def test_crowns_are_round_and_stand_on_trunks():
    cover = grown(crop="orchard", stage="fruit_development", plant_spacing_m=3.0, height_spread=0.0)
    middle = np.array([[0.0, 0.0], [0.8, 0.0], [0.0, 0.8], [1.6, 0.0], [0.0, 3.0], [3.5, 0.0]])
    height_m = cover.at(middle)
    assert height_m[0] == pytest.approx(3.5, abs=0.03)
    assert 2.05 < height_m[1] < 3.2
    assert height_m[2] == pytest.approx(height_m[1], abs=0.3)
    assert np.isnan(height_m[3])
    np.testing.assert_allclose(height_m[4:], 3.5, atol=0.1)
    row, column, _ = cover.grid.cell_of(middle[:2])
    low_m = cover.bottom_m[row, column]
    assert low_m[0] == pytest.approx(0.6, abs=0.03)
    assert low_m[1] > 0.8
    stands = cover.stand >= 0
    volume_m3 = np.sum(cover.top_m[stands] - cover.bottom_m[stands]) * cover.grid.spacing_m**2
    assert volume_m3 / 40**2 == pytest.approx(np.pi / 6 * 1.8**2 * 2.9 / (3.5 * 3.0), rel=0.1)


@pytest.mark.parametrize("plant_spacing_m", [1.5, 3.0])
def test_leaves_in_the_plants_add_up_to_the_leaf_area_index(plant_spacing_m):
    """Of crowns that are cut off by their neighbours, too: by the extinction, which is linear in the leaf area."""
    keys = {"crop": "orchard", "stage": "fruit_development", "height_spread": 0.0, "plant_spacing_m": plant_spacing_m}
    crowns = grown(**keys)
    wall = grown(crop="vines", stage="ripening", water_content=0.65, leaf_thickness_mm=0.25, leaf_area_index=2.0)
    totals = []
    for cover in (crowns, wall):
        depth_m = np.where(cover.stand >= 0, np.minimum(cover.top_m, 1e3) - np.maximum(cover.bottom_m, 0.0), 0.0)
        inside = np.ix_(np.abs(cover.grid.y_m) < 15, np.abs(cover.grid.x_m) < 14)
        totals.append(cover.extinction_per_m[0] * depth_m[inside].mean())
    assert totals[0] == pytest.approx(totals[1], rel=0.06)


def terraces(east_m):
    """Steps of 1.5 m with walls, every 8 m."""
    return 1.5 * np.floor(east_m / 8.0)


@pytest.mark.parametrize("ground", [lambda east_m: 0.3 * east_m, terraces])
def test_tops_follow_slopes_and_terraces(ground):
    east_m = np.arange(-60, 60.5, 0.5)
    terrain = Raster.from_array(np.tile(ground(east_m), (len(east_m), 1)), 0.5)
    cover = grown(CustomParts(terrain=terrain), height_spread=0.0, altitude_m=60.0)
    stands = cover.stand >= 0
    place_m = cover.grid.centres_m[stands.ravel()]
    flat = np.abs(place_m[:, 0] - 8 * np.round(place_m[:, 0] / 8)) > 0.6
    np.testing.assert_allclose((cover.top_m[stands] - ground(place_m[:, 0]))[flat], 1.1, atol=0.02)


def test_every_stage_of_every_crop_grows_and_higher_bands_lose_more():
    for name, crop in CROPS.items():
        for stage in crop.stages:
            heard = [
                grown(crop=name, stage=stage, scenario={"radar": radar}.items())
                for radar in ({"snr_db": 30.0, "carrier_hz": 24e9}, {"snr_db": 30.0, "carrier_hz": 77e9})
            ]
            low, high = (cover.extinction_per_m[0] for cover in heard)
            assert 0 < low < high < 8.0
            assert np.isfinite(heard[0].backscatter_per_m[0])
            assert heard[0].highest_m < 1.4 * crop.stages[stage].height_m


def test_given_values_override_those_of_the_leaves():
    cover = grown(extinction_db_per_m=1.0, backscatter_db_per_m=-20.0, height_m=0.7, height_spread=0.0)
    assert cover.extinction_per_m[0] == pytest.approx(np.log(10) / 10)
    assert cover.backscatter_per_m[0] == pytest.approx(0.01)
    assert cover.highest_m == 0.7


def test_a_stand_is_what_it_was():
    stand = {
        "kind": "stand",
        "polygon_m": FIELD,
        "height_m": 2.0,
        "extinction_db_per_m": 1.0,
        "backscatter_db_per_m": -20.0,
    }
    cover = prepare(field(scenario={"vegetation": [stand]}.items())).world.scene.vegetation
    assert cover.grid.spacing_m == 0.25
    assert np.all(np.isneginf(cover.bottom_m))
    assert set(np.unique(cover.plant_m[np.isfinite(cover.plant_m)])) == {2.0}
    np.testing.assert_allclose(cover.fraction_over(INSIDE), 1.0)
    assert np.all(np.isnan(cover.mean_over(Grid(west_m=40.0, south_m=0.0, spacing_m=1.0, columns=3, rows=2))))


def test_rows_that_no_cells_resolve_are_told(caplog):
    vast = [[-95, -95], [95, -95], [95, 95], [-95, 95]]
    cover = grown(row_spacing_m=0.15, row_width_m=0.08, polygon_m=vast)
    assert "do not resolve rows and gaps of 0.07 m" in caplog.text
    assert cover.fraction_over(INSIDE).mean() == pytest.approx(0.08 / 0.15, abs=0.25)


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"crop": "rice"}, r"crop: 'rice' is unknown; give one of maize, wheat, vines"),
        ({"crop": None}, r"crop: missing; give one of maize"),
        ({"stage": None}, r"stage: missing; give one of leaf_development, stem_elongation, flowering"),
        ({"stage": "june"}, r"stage: 'june' is no stage of maize; give one of leaf_development"),
        (
            {"row_width_m": 0.9},
            r"row_width_m: foliage 0\.9 m wide in rows 0\.75 m apart would cover 120%",
        ),
        (
            {"row_spacing_m": 0.5},
            r"row_spacing_m: foliage 0\.6 m wide .* 120% of the ground; give a row",
        ),
        ({"base_height_m": 1.2}, r"base_height_m: the lowest leaves, 1\.2 m .* lower base_height_m"),
        (
            {"crop": "vines", "stage": "ripening", "height_m": 0.5},
            r"height_m: the lowest leaves, 0\.6 m",
        ),
        ({"height_m": -1.0}, r"height_m: must be greater than 0, not -1"),
        ({"height_m": 0.0}, r"height_m: must be greater than 0"),
        ({"height_m": float("nan")}, r"height_m: must be a finite number"),
        ({"leaf_area_index": -0.5}, r"leaf_area_index: must be greater than 0"),
        ({"water_content": 1.0}, r"water_content: must be at most 0\.9"),
        ({"missing": 1.0}, r"missing: must be less than 1"),
        ({"missing": -0.1}, r"missing: must be at least 0"),
        ({"height_spread": 3.0}, r"height_spread: must be at most 0\.5"),
        ({"row_spacing_m": "0.75"}, r"row_spacing_m: must be a number without quotes"),
        ({"plant_spacing_m": 0.0}, r"plant_spacing_m: must be"),
        ({"least_height_m": 0.2}, r"least_height_m: has no effect on kind = 'crop'"),
        ({"path": "chm.tif"}, r"path: has no effect on kind = 'crop'"),
        ({"polygon_m": None}, r"polygon_m: missing; give the corners of the field"),
        ({"kind": "orchard"}, r"kind: must be one of 'stand', 'crop', not 'orchard'"),
        (
            {"kind": "stand", "height_m": 2.0},
            r"crop: has no effect on kind = 'stand'; remove it, or set",
        ),
        (
            {"kind": "stand", "crop": None, "stage": None, "height_m": 2.0},
            r"extinction_db_per_m: missing; add it",
        ),
        (
            {"polygon_m": [[900, 900], [950, 900], [950, 950]]},
            r"polygon_m: holds no plants over the terrain",
        ),
        ({"height_m": 40.0}, r"10\.0 m under the tops|m under the tops of \[\[vegetation\]\]"),
        ({"scenario": {"tracing": {"bounces": 2}}.items()}, r"tracing\.bounces: 2 is not traced through"),
    ],
)
def test_fields_that_cannot_be_are_refused(keys, says):
    with pytest.raises(ScenarioError, match=says) as refused:
        prepare(field(**keys))
    assert refused.value.problems[0].field.startswith(("vegetation.0.", "platform.altitude_m", "tracing.bounces"))
