"""A map that grows in windows, against the map of a whole survey."""

import numpy as np
import pytest

from sionna_radar.foundation.errors import OutputError, PoseError
from sionna_radar.foundation.raster import Raster
from sionna_radar.scenario import load_scenario
from sionna_radar.studies.live.live_map import LiveMap
from sionna_radar.studies.live.radar import Radar
from sionna_radar.survey.chain import run

pytestmark = pytest.mark.usefixtures("rough_errors")

# Six windows of 50 m; the seams of four of 60 m, over which a smooth map is looked at, need a longer one.
SHORT, LONG = ({"platform.length_m": length_m, "tracing.paths_per_pulse": 64} for length_m in (24.0, 40.0))


@pytest.fixture(scope="module")
def linear():
    return run(load_scenario("hills", SHORT))


@pytest.fixture(scope="module")
def frames(linear, step_along):
    return step_along(Radar(linear.prepared), linear.prepared.flight.time_s, 20)


@pytest.fixture(scope="module")
def smooth(step_along):
    survey = run(load_scenario("hills", LONG | {"dem.method": "smooth"}))
    return survey, step_along(Radar(survey.prepared), survey.prepared.flight.time_s, 20)


@pytest.fixture(scope="module")
def short_smooth(frames):
    """The short survey with a smooth map, and the frames, which are those of any map."""
    return run(load_scenario("hills", SHORT | {"dem.method": "smooth"})), frames


def grown(survey, frames, folder=None, *, looked=lambda _: None, **options):
    live = LiveMap(survey.prepared.mapper, folder, **options)
    for frame in frames:
        live.add(frame)
        looked(live)
    return live


@pytest.mark.parametrize("window_m", [500.0, 50.0])
def test_a_linear_map_is_that_of_the_survey_bit_for_bit(linear, frames, window_m):
    live = grown(linear, frames, window_m=window_m)
    assert len(live) == (1 if window_m == 500.0 else 6)
    np.testing.assert_array_equal(live.dem().height_m, linear.dem.height_m)
    np.testing.assert_array_equal(live.sigma().filled, linear.dem_sigma.filled)
    ratio = live.sigma().height_m / linear.dem_sigma.height_m
    if window_m == 500.0:
        np.testing.assert_array_equal(live.sigma().height_m, linear.dem_sigma.height_m)
    else:
        # Each window has a terrain model of its own.
        assert np.nanquantile(np.abs(np.log(ratio)), 0.9) < 0.35


def test_a_smooth_map_is_that_of_the_survey_within_a_centimetre(smooth):
    survey, frames = smooth
    live = grown(survey, frames, window_m=60.0)
    assert len(live) == 4
    both = live.dem().filled & survey.dem.filled
    assert both.sum() > 0.97 * survey.dem.filled.sum()
    assert np.sqrt(np.mean((live.dem().height_m - survey.dem.height_m)[both] ** 2)) < 0.01
    one = grown(survey, frames)
    np.testing.assert_array_equal(one.dem().height_m, survey.dem.height_m)
    np.testing.assert_array_equal(one.sigma().height_m, survey.dem_sigma.height_m)


@pytest.mark.parametrize("method", ["linear", "smooth"])
def test_a_wire_is_no_ground_of_a_live_map_either(step_along, method):
    wire = {
        "points_m": [[-55.0, -40.0, 12.0], [-55.0, 40.0, 12.0]],
        "diameter_mm": 20.0,
        "strands": 12,
        "lay_mm": 200.0,
    }
    survey = run(load_scenario("hills", SHORT | {"dem.method": method, "wires": [wire]}))
    assert survey.obstacles.rates()["pd_wire"] == 1.0
    live = grown(survey, step_along(Radar(survey.prepared), survey.prepared.flight.time_s, 20))
    np.testing.assert_array_equal(live.dem().height_m, survey.dem.height_m)
    np.testing.assert_array_equal(live.sigma().height_m, survey.dem_sigma.height_m)


@pytest.mark.parametrize("method", ["linear", "smooth"])
def test_windows_on_disk_and_looks_in_between_change_nothing(linear, frames, short_smooth, tmp_path, method):
    survey, of_survey = (linear, frames) if method == "linear" else short_smooth
    looks = iter(range(1000))

    def look(live):
        if next(looks) % 20 == 8:
            live.dem()

    kept = grown(survey, of_survey, tmp_path / "kept", looked=look, window_m=50.0, echoes_in_memory=150)
    apart = grown(survey, of_survey, window_m=50.0)
    assert sum(kept._held.values()) <= 150
    assert len(apart._held) == 6
    np.testing.assert_array_equal(kept.dem().height_m, apart.dem().height_m)
    np.testing.assert_array_equal(kept.sigma().height_m, apart.sigma().height_m)
    whole = kept.dem()
    finished = [number for number in range(len(kept)) if number not in kept._held]
    rasters = [Raster.read(tmp_path / "kept" / f"window_{number:04d}_dem.tif") for number in finished]
    assert rasters
    for raster in rasters:
        east, north = np.meshgrid(raster.grid.x_m, raster.grid.y_m)
        row, column, inside = whole.grid.cell_of(np.column_stack([east.ravel(), north.ravel()]))
        assert inside.all()
        np.testing.assert_array_equal(
            raster.height_m.ravel(), whole.height_m[row, column].astype(np.float32).astype(np.float64)
        )


def test_what_changed_is_named(linear, frames):
    live = LiveMap(linear.prepared.mapper, window_m=50.0)
    assert live.changed() is None
    before = live.dem().height_m
    assert np.isnan(before).all()
    assert live.sigma() is None
    for number, frame in enumerate(frames):
        live.add(frame)
        if number % 5 and number < len(frames) - 2:
            continue
        changed, after = live.changed(), live.dem().height_m
        same = np.ones(after.shape, dtype=bool)
        if changed is not None:
            same[changed] = False
        np.testing.assert_array_equal(after[same], before[same])
        before = after
    assert live.changed() is None
    assert changed != (slice(0, before.shape[0]), slice(0, before.shape[1]))


def test_what_is_in_memory_is_bounded(linear, frames):
    """Over one place for ever, too: in a single window."""
    for window_m in (50.0, 500.0):
        live = LiveMap(linear.prepared.mapper, window_m=window_m, echoes_in_memory=50)
        for frame in frames:
            live.add(frame)
            held = [points for window in live._windows for points in window.points]
            assert sum(map(len, held)) == sum(live._held.values()) <= 50
            assert all(number in live._held for number, window in enumerate(live._windows) if window.points)
    np.testing.assert_array_equal(live.dem().height_m, linear.dem.height_m)


def test_frames_are_added_once_and_in_order(linear, frames):
    live = LiveMap(linear.prepared.mapper)
    some = [frame for frame in frames if len(frame.points)][:2]
    live.add(some[1])
    for frame in some:
        with pytest.raises(PoseError, match="add the frames of one radar, each once and in order"):
            live.add(frame)


def test_a_folder_that_holds_files_is_refused_and_a_temporary_one_goes(linear, tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(OutputError, match="give the live map a new folder, or an empty one"):
        LiveMap(linear.prepared.mapper, tmp_path)
    live = LiveMap(linear.prepared.mapper)
    folder = live._folder
    assert folder.is_dir()
    del live
    assert not folder.exists()
    assert (tmp_path / "mine.txt").read_text() == "mine"
