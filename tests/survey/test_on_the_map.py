"""A survey over an elevation file with a place on the Earth: its products fit the file, cell by cell."""

import json
from pathlib import Path

import laspy
import numpy as np
import pytest
import rasterio
from pyproj import CRS, Transformer
from rasterio.windows import from_bounds
from scipy.ndimage import gaussian_filter

from elevation_files import from_origin, write_heights
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.raster import Georeference, MapCells
from sionna_radar.report.survey.products import write_survey
from sionna_radar.report.survey.summary import georeference
from sionna_radar.scenario import Scenario, load_scenario, parse_scenario
from sionna_radar.survey.chain import run
from sionna_radar.survey.map_positions import in_local_frame
from sionna_radar.survey.reprocessing import process
from worlds import load_ground

# Neither a whole number nor at a cell's middle: nothing lines up by chance.
WEST, NORTH = 450_000.37, 5_000_100.61
EVERYWHERE = (-1e5, -1e5, 1e5, 1e5)


def write_file(path: Path, cell_m: float = 1.0, crs: str = "EPSG:32632", span_m: float = 240.0) -> Path:
    cells = round(span_m / cell_m)
    noise = gaussian_filter(np.random.default_rng(0).normal(size=(cells, cells)), 15 / cell_m, mode="wrap")
    height = (300 + 2 * noise / noise.std()).astype(np.float32)
    return write_heights(path, height, from_origin(WEST, NORTH, cell_m, cell_m), crs)


def scenario_over(path: Path, **tables: dict[str, object]) -> Scenario:
    data: dict[str, dict[str, object]] = {
        "terrain": {"kind": "raster", "path": str(path)},
        "platform": {"altitude_m": 40.0, "speed_mps": 10.0, "length_m": 20.0},
        "radar": {
            "snr_db": 30.0,
            "chirp_rate_hz": 200.0,
            "samples_per_chirp": 512,
            "scan": {"incidence_deg": 30.0, "half_swath_deg": 20.0, "rotation_rpm": 120.0},
        },
        "tracing": {"paths_per_pulse": 64},
    }
    for name, table in tables.items():
        data[name] = {**data.get(name, {}), **table}
    return parse_scenario(data)


@pytest.mark.parametrize(("cell_m", "spacing_m"), [(1.0, 1.0), (2.0, 1.0), (1.0, 3.0)])
def test_input_and_output_subtract_cell_by_cell(tmp_path: Path, cell_m: float, spacing_m: float) -> None:
    source = write_file(tmp_path / "in.tif", cell_m)
    write_survey(run(scenario_over(source, dem={"spacing_m": spacing_m})), tmp_path / "out")
    with rasterio.open(source) as file, rasterio.open(tmp_path / "out" / "truth.tif") as truth:
        coarser = max(cell_m, spacing_m)
        for edge, from_file in ((truth.bounds.left, WEST), (truth.bounds.top, NORTH)):
            cells = (edge - from_file) / min(cell_m, spacing_m)
            assert cells == pytest.approx(round(cells), abs=1e-5)
        assert truth.transform.a == spacing_m
        if coarser == cell_m == spacing_m:
            window = from_bounds(*truth.bounds, transform=file.transform).round_offsets().round_lengths()
            assert (window.height, window.width) == truth.shape
            np.testing.assert_allclose(truth.read(1), file.read(1, window=window), atol=1e-3)


def test_a_grid_that_fits_no_cells_lies_on_whole_multiples_of_its_spacing() -> None:
    cells = MapCells(corner_m=(WEST, NORTH), size_m=(1.0, 1.0))
    place = Georeference(crs_wkt="", origin_m=(450_010.3, 5_000_000.9, 0.0), cells=cells)
    for spacing in (0.7, 1.5):
        centre = np.array(place.cell_centre_m(spacing)) + place.origin_m[:2]
        steps = (centre - spacing / 2) / spacing
        np.testing.assert_allclose(steps, np.round(steps), atol=1e-5)


# ----------------------------------------------------------------------------------- positions on the map


START = (450_110.0, 5_000_000.0)
CORNERS = ((450_090.0, 4_999_970.0), (450_150.0, 4_999_970.0), (450_150.0, 5_000_030.0))
BOX = (450_140.0, 5_000_010.0)


def placed_scenario(path: Path, coordinates: str, crs: str = "EPSG:32632") -> Scenario:
    """The same places, written in some CRS or as longitudes and latitudes."""
    to = Transformer.from_crs("EPSG:32632", crs, always_xy=True)

    def at(position: tuple[float, float]) -> list[float]:
        return list(to.transform(*position))

    scenario = scenario_over(
        path,
        terrain={"cover": [{"polygon_m": [at(c) for c in CORNERS], "material": "building"}]},
        platform={"start_m": at(START)},
    )
    data = scenario.model_dump(mode="json", exclude_none=True)
    data["coordinates"] = coordinates
    data["buildings"] = [{"position_m": at(BOX), "size_m": [8.0, 6.0, 5.0]}]
    data["targets"] = [{"position_m": at(BOX), "rcs_dbsm": 10.0}]
    return parse_scenario(data)


@pytest.mark.parametrize(
    ("coordinates", "crs"), [("EPSG:32632", "EPSG:32632"), ("lonlat", "EPSG:4326"), ("EPSG:25833", "EPSG:25833")]
)
def test_positions_on_the_map_come_to_lie_where_they_are(tmp_path: Path, coordinates: str, crs: str) -> None:
    scenario = placed_scenario(write_file(tmp_path / "in.tif"), coordinates, crs)
    local = in_local_frame(scenario)
    origin = np.array([WEST + 120, NORTH - 120])
    tolerance = {"atol": 1e-4, "rtol": 0}
    np.testing.assert_allclose(local.platform.start_m + origin, START, **tolerance)
    np.testing.assert_allclose(np.array(local.terrain.cover[0].polygon_m) + origin, CORNERS, **tolerance)
    np.testing.assert_allclose(local.buildings[0].position_m + origin, BOX, **tolerance)
    np.testing.assert_allclose(local.targets[0].position_m + origin, BOX, **tolerance)
    assert in_local_frame(local) == local


def test_a_recorded_flight_on_the_map_knows_its_covers(tmp_path: Path) -> None:
    scenario = placed_scenario(write_file(tmp_path / "in.tif"), "lonlat", "EPSG:4326")
    known = scenario.dem.model_copy(update={"cover": "known", "method": "smooth", "method_parameters": None})
    flown = run(scenario.model_copy(update={"dem": known}), recordings={"signals": tmp_path / "beats.nc"})
    cover = flown.prepared.mapper.cover
    assert cover is not None
    inside = cover.cover[cover.grid.cell_of(np.array([[-10.0, -30.0], [15.0, 0.0], [-20.0, 20.0]]))[:2]]
    assert inside[1] not in (inside[0], inside[2])
    np.testing.assert_array_equal(process(tmp_path / "beats.nc").dem.height_m, flown.dem.height_m)


def test_a_survey_flies_from_its_start_on_the_map(tmp_path: Path) -> None:
    path = write_file(tmp_path / "in.tif")
    survey = run(placed_scenario(path, "lonlat", "EPSG:4326"))
    assert survey.scenario.coordinates == "lonlat"
    start = survey.schedule.trajectory.position(np.zeros(1))[0, :2] + survey.georeference.origin_m[:2]
    np.testing.assert_allclose(start, START, atol=1e-4)
    assert survey.off_wall_error is not None  # the building stands where the map of walls looks for it


@pytest.mark.parametrize(
    ("coordinates", "field", "why"),
    [
        ("EPSG:999999", "coordinates", "is not a coordinate reference system"),
        ("EPSG:5703", "coordinates", "neither projected nor geographic"),
        ("lonlat", "platform.start_m", "is not valid in 'WGS 84'; give longitude and latitude, in this order"),
    ],
)
def test_positions_without_a_place_are_refused(tmp_path: Path, coordinates: str, field: str, why: str) -> None:
    scenario = placed_scenario(write_file(tmp_path / "in.tif"), coordinates)
    with pytest.raises(ScenarioError) as caught:
        in_local_frame(scenario)
    assert caught.value.problems[0].field == field
    assert why in caught.value.problems[0].message


@pytest.mark.parametrize("scene", ["hills", "san_francisco"])
def test_a_world_that_lies_nowhere_takes_no_map_coordinates(scene: str) -> None:
    with pytest.raises(ScenarioError, match=r"coordinates.*or coordinates = 'local'"):
        load_scenario(scene, {"coordinates": "lonlat"})


# -------------------------------------------------------------------------------------- heights and datum


@pytest.mark.parametrize(
    ("crs", "stated", "vertical", "metres"),
    [
        ("EPSG:32632", {}, None, 1.0),
        ("EPSG:32632+5773", {}, "EPSG:5773", 1.0),
        ("EPSG:32632+6360", {}, "EPSG:5703", 1200 / 3937),  # NAVD88 in US survey feet
        ("EPSG:32632", {"vertical_crs": "EPSG:5703", "height_unit": "ft"}, "EPSG:5703", 0.3048),
        ("EPSG:32632", {"height_unit": "ftUS"}, None, 1200 / 3937),
        ("EPSG:32632", {"vertical_crs": "EPSG:5715"}, "EPSG:5714", -1.0),  # a depth
    ],
)
def test_heights_become_metres_above_their_datum(
    tmp_path: Path, crs: str, stated: dict[str, object], vertical: str | None, metres: float
) -> None:
    plain, _ = load_ground(scenario_over(write_file(tmp_path / "a.tif")).terrain, EVERYWHERE)
    scenario = scenario_over(write_file(tmp_path / "b.tif", crs=crs), terrain=stated)
    raster, place = load_ground(scenario.terrain, EVERYWHERE)
    assert place is not None
    told = georeference(place)
    assert told is not None
    assert (told["horizontal_crs"], told["vertical_crs"]) == ("EPSG:32632", vertical)
    np.testing.assert_allclose(np.ptp(raster.height_m), abs(metres) * np.ptp(plain.height_m), rtol=1e-6)
    assert place.origin_m[2] == pytest.approx(metres * 297, abs=12)


@pytest.mark.parametrize(
    ("stated", "why"),
    [("EPSG:32632", "is not a vertical CRS"), ("EPSG:999999", "is not a coordinate reference system")],
)
def test_a_vertical_crs_is_one(tmp_path: Path, stated: str, why: str) -> None:
    scenario = scenario_over(write_file(tmp_path / "a.tif"), terrain={"vertical_crs": stated})
    with pytest.raises(ScenarioError, match=rf"terrain.vertical_crs.*{why}"):
        load_ground(scenario.terrain, EVERYWHERE)


def test_a_compound_crs_reaches_the_products(tmp_path: Path) -> None:
    survey = run(scenario_over(write_file(tmp_path / "in.tif", crs="EPSG:32632+5773")))
    write_survey(survey, tmp_path / "out")
    with rasterio.open(tmp_path / "out" / "dem.tif") as file:
        raster_crs = CRS.from_wkt(file.crs.to_wkt())
    for crs in (raster_crs, laspy.read(tmp_path / "out" / "points.laz").header.parse_crs()):
        assert [part.to_epsg() for part in crs.sub_crs_list] == [32632, 5773]
    place = json.loads((tmp_path / "out" / "summary.json").read_text())["georeference"]
    assert place["vertical_datum"] == "EGM96 geoid"
    assert place["origin"]["easting_m"] == pytest.approx(WEST + 120)
    # Meridian convergence, 9 deg E being the zone's middle.
    lon, lat = Transformer.from_crs(32632, 4326, always_xy=True).transform(WEST + 120, NORTH - 120)
    assert place["convergence_deg"] == pytest.approx((lon - 9) * np.sin(np.deg2rad(lat)), abs=1e-3)
