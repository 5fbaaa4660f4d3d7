"""Where the ground is expected: windows of ranges against closed forms, what lies outside them, and bad input."""

import warnings
from functools import cache

import numpy as np
import pytest
import rasterio
from pyproj import CRS, Transformer

from beams import make_antenna, make_chirp
from elevation_files import from_origin, write_heights
from flights import make_pulses
from sionna_radar import load_scenario, run
from sionna_radar.detection.build import build_detector, build_expected_ground
from sionna_radar.foundation.raster import Georeference, Grid
from sionna_radar.scenario import parse_scenario
from sionna_radar.scenario.processing import ProcessingTable
from sionna_radar.survey.preparation import prepare
from sionna_radar.survey.sensors.radar import Radar

KEY = "processing.expected_ground"
SHORT = {"platform.length_m": 2.0, "tracing.paths_per_pulse": 32}
GRID = Grid(west_m=-100.0, south_m=-100.0, spacing_m=2.0, columns=101, rows=101)
EVERYWHERE = np.array([-np.inf, np.inf])


def geotiff(folder, height_m, *, west_m=-500.0, north_m=500.0, spacing_m=25.0, crs=None):
    """Write heights as a GeoTIFF whose north-west corner is given."""
    corner = from_origin(west_m, north_m, spacing_m, spacing_m)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        return write_heights(folder / "rough.tif", height_m.astype("float32"), corner, crs)


def expected(antenna, *, place=None, **table):
    scenario = parse_scenario(
        {
            "terrain": {"kind": "flat", "size_m": [300.0, 300.0]},
            "platform": {"altitude_m": 50.0, "speed_mps": 10.0, "length_m": 10.0},
            "radar": {"snr_db": 30.0},
            "processing": {"expected_ground": {"tolerance_m": 3.0} | table},
        }
    )
    return build_expected_ground(scenario.processing.expected_ground, 50.0, antenna, GRID, place)


@pytest.mark.parametrize("direction", ["up", "down"])
@pytest.mark.parametrize(("incidence_deg", "speed_mps"), [(0.0, 10.0), (45.0, 10.0), (60.0, -20.0)])
def test_over_level_ground_the_beam_s_edges_and_the_motion_make_the_window(incidence_deg, speed_mps, direction):
    """Steepest edge to the highest ground, flattest edge to the lowest, plus the sweep's shift by the motion."""
    chirp, antenna = make_chirp(), make_antenna(4.0, 2.0)
    if direction == "down":
        chirp = make_chirp(sweep="down")
    azimuth, elevation = antenna.beamwidths_rad
    incidence = np.deg2rad(incidence_deg)
    pulses = make_pulses(1, incidence_deg=incidence_deg, velocity_mps=(0.0, speed_mps, 0.0))
    window = expected(antenna).window_m(pulses, chirp)
    # The azimuth edges of a beam that looks along the track leave nadir by this much.
    beside = np.arccos(np.cos(incidence) * np.cos(azimuth))
    steepest = incidence if incidence_deg == 0 else incidence - elevation
    flattest = max(incidence + elevation, beside)
    receding_mps = -speed_mps * np.sin(incidence)
    sign = 1 if direction == "up" else -1
    shift_m = sign * receding_mps * chirp.carrier_hz / (chirp.bandwidth_hz * chirp.rate_hz)
    nearest, farthest = (50.0 - 3.0) / np.cos(steepest), (50.0 + 3.0) / np.cos(flattest)
    np.testing.assert_allclose(window, [[nearest + shift_m, farthest + shift_m]], rtol=1e-9)


def test_a_beam_that_meets_no_expected_ground_keeps_what_it_can(pencil):
    edge = np.rad2deg(pencil.beamwidths_rad[1]) / 2
    pulses = make_pulses(3, incidence_deg=0.0, scan_deg=np.array([0.0, 90.0 - edge, 120.0]))
    window = expected(pencil).window_m(pulses, make_chirp())
    assert np.all(np.isfinite(window[0]))
    assert np.isfinite(window[1, 0])
    assert window[1, 1] == np.inf
    np.testing.assert_array_equal(window[2], EVERYWHERE)


def test_below_the_highest_expected_ground_the_window_starts_at_nothing(pencil):
    pulses = make_pulses(1, velocity_mps=(0.0, 0.0, 0.0))
    window = expected(pencil, tolerance_m=80.0).window_m(pulses, make_chirp())
    assert window[0, 0] == 0.0
    assert window[0, 1] == pytest.approx(130.0 / np.cos(max(pencil.beamwidths_rad)))


def slope_window(antenna, incidence_deg, slope):
    """Ranges from 50 m over the foot of ground that rises toward north by a slope, 3 m up and down."""
    elevation = antenna.beamwidths_rad[1]
    angles = np.deg2rad(incidence_deg) + np.array([-elevation, elevation])
    return np.array([47.0, 53.0]) / (np.cos(angles) + slope * np.sin(angles))


def test_the_window_of_a_rough_dem_follows_its_slope(tmp_path, pencil):
    """Rows go south in a file: a slope read upside down would put the window 40 m off."""
    y = 500.0 - 25.0 * (np.arange(40) + 0.5)
    path = geotiff(tmp_path, np.tile(0.3 * y[:, None], (1, 40)))
    pulses = make_pulses(1, incidence_deg=40.0, velocity_mps=(0.0, 0.0, 0.0))
    window = expected(pencil, path=str(path)).window_m(pulses, make_chirp())
    np.testing.assert_allclose(window[0], slope_window(pencil, 40.0, 0.3), atol=0.02)


def test_a_rough_dem_in_degrees_lies_where_the_survey_is(tmp_path, pencil):
    """A georeferenced survey; the file is in another CRS, and its heights count from the datum."""
    utm = CRS.from_epsg(32633)
    place = Georeference(crs_wkt=utm.to_wkt(), origin_m=(500_000.0, 5_400_000.0, 250.0))
    to_degrees = Transformer.from_crs(utm, 4326, always_xy=True)
    longitude, latitude = to_degrees.transform(*place.origin_m[:2])
    metres_per_degree = 1000.0 / (to_degrees.transform(500_000.0, 5_401_000.0)[1] - latitude)
    north_m = metres_per_degree * (0.01 - 0.0005 * (np.arange(40) + 0.5))
    heights = np.tile(250 + 0.3 * north_m[:, None], (1, 40))
    corner = {"west_m": longitude - 0.01, "north_m": latitude + 0.01, "spacing_m": 0.0005}
    path = geotiff(tmp_path, heights, **corner, crs="EPSG:4326")
    pulses = make_pulses(1, incidence_deg=40.0, velocity_mps=(0.0, 0.0, 0.0))
    window = expected(pencil, path=str(path), place=place).window_m(pulses, make_chirp())
    np.testing.assert_allclose(window[0], slope_window(pencil, 40.0, 0.3), atol=0.1)


@pytest.mark.parametrize("hole", [np.nan, -9999.0, 3e38])
def test_holes_of_a_rough_dem_take_its_mean(tmp_path, pencil, hole):
    heights = np.full((40, 40), 12.0)
    heights[:, 21:] = hole
    pulses = make_pulses(1, velocity_mps=(0.0, 0.0, 0.0), position_m=(60.0, 0.0, 50.0))
    window = expected(pencil, path=str(geotiff(tmp_path, heights))).window_m(pulses, make_chirp())
    np.testing.assert_allclose(window[0], [35.0, 41.0 / np.cos(max(pencil.beamwidths_rad))], atol=0.01)


def test_heights_of_a_rough_dem_are_those_of_its_scale_and_offset(tmp_path, pencil):
    path = geotiff(tmp_path, np.full((40, 40), 340.0))
    with rasterio.open(path, "r+") as file:
        file.scales, file.offsets = [0.05], [-5.0]
    window = expected(pencil, path=str(path)).window_m(make_pulses(1, velocity_mps=(0.0, 0.0, 0.0)), make_chirp())
    np.testing.assert_allclose(window[0], [35.0, 41.0 / np.cos(max(pencil.beamwidths_rad))], atol=0.01)


def test_a_single_cell_is_a_dem(tmp_path, pencil):
    path = geotiff(tmp_path, np.full((1, 1), 5.0), spacing_m=1000.0)
    window = expected(pencil, path=str(path)).window_m(make_pulses(1, velocity_mps=(0.0, 0.0, 0.0)), make_chirp())
    assert window[0, 0] == pytest.approx(42.0)


def test_a_stronger_target_off_the_ground_is_refused_in_clear_air():
    chirp = make_chirp()
    rng = np.random.default_rng(4)
    phase = 2 * np.pi * chirp.beat_per_metre_hz * chirp.sample_time_s
    beat = (np.cos(70.0 * phase) + 5 * np.cos(40.0 * phase) + 0.3 * rng.normal(size=chirp.samples))[None]
    detector = build_detector(ProcessingTable(), chirp)
    pulse, power = np.array([0]), detector.analyser.power(beat)
    assert detector.find_in(power, pulse).echoes.range_m == pytest.approx([40.0], abs=0.1)
    assert detector.find_in(power, pulse, np.array([[60.0, 80.0]])).echoes.range_m == pytest.approx([70.0], abs=0.1)
    # Between the two, and in a window without a cell, there is nothing.
    assert len(detector.find_in(power, pulse, np.array([[45.0, 65.0]])).echoes) == 0
    assert len(detector.find_in(power, pulse, np.array([[20.0, 10.0]])).echoes) == 0


@cache
def in_rain():
    """Spectra of hills through rain, and where their ground is."""
    ready = prepare(load_scenario("hills", SHORT | {"weather.rain_rate_mm_per_h": 4.0}))
    sensor = Radar(ready.sensor_inputs())
    pulses = ready.flight.pulses(np.arange(len(ready.flight)))
    power = ready.instrument.detector.analyser.power(ready.receiver.beat(sensor.tracer.trace(pulses), pulses))
    return ready, sensor.sweeps.through[0], pulses, power


def test_a_target_in_rain_is_refused_and_the_ground_behind_it_found():
    ready, through, pulses, power = in_rain()
    free = through.find(power, pulses, ready.receiver.chirp).echoes
    assert len(free) == len(pulses)
    # A bird 50 dB over the rain and 25 m in front of the ground, in one pulse after another.
    stride = ready.instrument.detector.analyser.zero_padding
    bird_m = free.range_m - 25.0
    cell = np.rint(bird_m / ready.receiver.chirp.range_resolution_m).astype(int)
    struck = power.copy()
    for step in (-1, 0, 1):
        struck[np.arange(len(pulses)), stride * cell + step] = 1e5 * through.volume.background[cell]
    found = through.find(struck, pulses, ready.receiver.chirp).echoes
    assert np.median(found.range_m - bird_m[found.pulse]) < 5.0
    window = np.column_stack([free.range_m - 15.0, free.range_m + 15.0])
    found = through.find(struck, pulses, ready.receiver.chirp, window).echoes
    assert len(found) == len(pulses)
    assert np.abs(found.range_m - free.range_m).max() < 0.3


@pytest.mark.parametrize("offset_m", [-50.0, -25.0, 25.0])
def test_behind_rain_there_is_no_ground_where_it_is_expected_wrongly(offset_m):
    """The rain ends elsewhere, and that is heard: the likeliest of the expected ranges is still none."""
    ready, through, pulses, power = in_rain()
    ground_m = through.find(power, pulses, ready.receiver.chirp).echoes.range_m
    window = ground_m[:, None] + offset_m + np.array([-10.0, 10.0])
    assert len(through.find(power, pulses, ready.receiver.chirp, window).echoes) == 0
    nowhere = np.tile([30.0, 20.0], (len(pulses), 1))
    assert len(through.find(power, pulses, ready.receiver.chirp, nowhere).echoes) == 0


@pytest.mark.parametrize("rate", [0.0, 4.0])
def test_a_survey_without_ground_where_it_is_expected_says_so(small, tmp_path, rate):
    path = geotiff(tmp_path, np.full((40, 40), 40.0))
    changes = {f"{KEY}.path": str(path), f"{KEY}.tolerance_m": 2.0, "weather.rain_rate_mm_per_h": rate}
    survey = run(load_scenario(small, SHORT | changes))
    assert len(survey.points) == 0
    assert len(survey.warnings) == 1
    assert KEY in survey.warnings[0]


def test_an_altimeter_s_window_around_the_ground_changes_nothing():
    ready, through, pulses, power = in_rain()
    window = expected(ready.instrument.antenna, tolerance_m=20.0).window_m(pulses, ready.receiver.chirp)
    assert np.all(np.isfinite(window))
    free, told = (through.find(power, pulses, ready.receiver.chirp, one).echoes for one in (None, window))
    np.testing.assert_array_equal(told.pulse, free.pulse)
    np.testing.assert_allclose(told.range_m, free.range_m, atol=0.05)


BAD = {
    "missing": ({}, 5.0, "does not exist"),
    "crs on one side": ({"crs": "EPSG:32633"}, 5.0, "is not georeferenced"),
    "elsewhere": ({"west_m": 5000.0}, 5.0, "does not overlap the survey"),
    "no heights": ({"height": np.nan}, 5.0, "has no heights under the survey"),
    "no tolerance": ({}, 0.0, "must be greater than 0"),
}


@pytest.mark.parametrize("kind", BAD)
def test_a_bad_expectation_is_one_error(cli, small, tmp_path, kind):
    raster, tolerance_m, words = BAD[kind]
    path = geotiff(tmp_path, np.full((40, 40), raster.pop("height", 0.0)), **raster)
    if kind == "missing":
        path.unlink()
    before = sorted(tmp_path.iterdir())
    settings = ["--set", f"{KEY}.path={path}", "--set", f"{KEY}.tolerance_m={tolerance_m}"]
    done = cli("run", small, "-o", tmp_path / "out", *settings, code=2)
    assert KEY in done.stderr
    assert words in " ".join(done.stderr.split())
    assert sorted(tmp_path.iterdir()) == before


def test_a_file_without_crs_cannot_be_placed_on_the_earth(cli, tmp_path):
    path = geotiff(tmp_path, np.full((40, 40), 0.0))
    changes = ["--set", f"{KEY}.path={path}", "--set", f"{KEY}.tolerance_m=5"]
    done = cli("validate", "jacksboro", *changes, code=2)
    assert f"{KEY}.path: the raster has no CRS" in " ".join(done.stderr.split())
