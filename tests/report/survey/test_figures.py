"""Figures draw for every kind of survey, carry their units, and do not invent data."""

from collections.abc import Callable
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import imread

from drawn_texts import texts_outside
from sionna_radar import load_scenario, run
from sionna_radar.flight.pulses import Pose
from sionna_radar.report import drawing
from sionna_radar.report.coordinates import Coordinates
from sionna_radar.report.drawing import readable, save_figures
from sionna_radar.report.survey import figures
from sionna_radar.report.survey.figures import draw_environment
from sionna_radar.scenario.terrain import RasterTerrain
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.survey.result import Survey
from surveys import make_survey
from worlds import make_surface

DRAWINGS = (draw_environment, figures.draw_chirp, figures.draw_power, figures.draw_dem, figures.draw_error)


def outlines(figure: Figure) -> list[tuple[str, object]]:
    """Outlines of the titles and axis labels, in pixels."""
    figure.draw_without_rendering()
    axes = [*figure.axes, *(child for a in figure.axes for child in a.child_axes)]
    texts = [t for a in axes for t in (a.title, a.xaxis.label, a.yaxis.label) if t.get_text()]
    return [(t.get_text(), t.get_window_extent()) for t in texts]


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("radar.antenna.beamwidth_deg", "Beamwidth (deg)"),
        ("weather.backscatter_db_per_m", "Backscatter (dB/m)"),
        ("radar.transmit_power_w", "Transmit power (W)"),
        ("processing.cfar.guard", "CFAR guard"),
    ],
)
def test_a_key_reads_as_words_with_its_unit(key: str, words: str) -> None:
    assert readable(key) == words


def test_figures_are_written_under_their_names(survey: Survey, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drawing, "DPI", 60)
    paths = save_figures(survey, figures.figures_of(survey), tmp_path / "figures")
    names = ["environment.png", "chirp.png", "power_map.png", "dem.png", "error_map.png"]
    assert [p.name for p in paths] == names
    assert all(imread(p).std() > 0.05 for p in paths)
    for path, draw in zip(paths, DRAWINGS, strict=True):
        draw(survey).savefig(tmp_path / "plain.png", dpi=60)
        np.testing.assert_array_equal(imread(path), imread(tmp_path / "plain.png"))


@pytest.mark.parametrize("draw", DRAWINGS)
def test_no_echo_and_empty_dem(empty: Survey, draw: Callable[[Survey], Figure]) -> None:
    figure = draw(empty)
    figure.draw_without_rendering()
    assert figure.axes


@pytest.mark.parametrize("draw", DRAWINGS)
def test_text_keeps_apart_on_small_and_large_ground(
    little: Survey, large: Survey, draw: Callable[[Survey], Figure]
) -> None:
    for shown in (little, large):
        figure = draw(shown)
        for (a, first), (b, second) in combinations(outlines(figure), 2):
            assert not first.overlaps(second), (a, b)


def test_warnings_over_figures_name_files_without_their_folders(survey: Survey, tmp_path: Path) -> None:
    path = tmp_path / "a site" / "ground.tif"
    terrain = RasterTerrain(kind="raster", path=path)
    scenario = survey.scenario.model_copy(update={"terrain": terrain})
    warned = replace(
        survey,
        prepared=replace(survey.prepared, scenario=scenario),
        warnings=(f"terrain.path = {path}: 3 cells are odd",),
    )
    title = figures.draw_error(warned).get_suptitle()
    assert title == "Warning: terrain.path = ground.tif: 3 cells are odd"


@pytest.fixture(scope="module")
def narrow() -> Survey:
    return run(load_scenario("hills", {"platform.length_m": 5.0}))


@pytest.fixture(scope="module")
def little() -> Survey:
    return make_survey(size_m=100.0, height_m=700.0, sampling="iq")


@pytest.fixture(scope="module")
def large() -> Survey:
    return make_survey(size_m=2000.0, height_m=700.0, sampling="iq")


@pytest.mark.parametrize("draw", DRAWINGS)
def test_no_text_is_cut_off(survey: Survey, large: Survey, narrow: Survey, draw: Callable[[Survey], Figure]) -> None:
    for flown in (survey, large, narrow):
        assert texts_outside(draw(flown)) == []


@pytest.mark.parametrize("draw", DRAWINGS)
def test_axes_have_units(survey: Survey, draw: Callable[[Survey], Figure]) -> None:
    for axes in draw(survey).axes:
        for label in (axes.get_xlabel(), axes.get_ylabel()):
            assert label == "" or "(" in label


def test_settings_of_matplotlib_stay(survey: Survey) -> None:
    before = dict(matplotlib.rcParams)
    figures.draw_dem(survey).draw_without_rendering()
    assert dict(matplotlib.rcParams) == before


def test_dem_and_truth_share_limits(survey: Survey) -> None:
    left, right = (a for a in figures.draw_dem(survey).axes if a.images)
    assert left.images[0].get_clim() == right.images[0].get_clim()


def test_error_colours_are_symmetric_and_robust(survey: Survey) -> None:
    outlier = survey.error.height_m.copy()
    outlier[0, 0] = 500.0
    spoiled = replace(survey, error=replace(survey.error, height_m=outlier))
    low, high = figures.draw_error(spoiled).axes[0].images[0].get_clim()
    # The errors are normal with a spread of 0.2 m about 0.05 m; 99 in 100 lie within about 0.55 m.
    assert low == -high
    assert 0.4 < high < 0.7


def test_brightest_echo_survives_thinning(survey: Survey, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(figures, "MAX_SCATTER", 10)
    axes = figures.draw_power(survey).axes[0]
    brightest = survey.points.position_m[np.argmax(survey.points.power), :2]
    offsets = np.asarray(axes.collections[0].get_offsets())
    assert len(offsets) < len(survey.points)
    assert np.isclose(offsets, brightest).all(axis=1).any()


def test_boresight_meets_a_slope_where_geometry_says(survey: Survey) -> None:
    slope = make_surface(lambda x, y: 0.1 * x, size_m=200.0)
    world = replace(survey.prepared.world, caster=RayCaster((slope,)))
    over_slope = replace(survey, prepared=replace(survey.prepared, world=world))
    boresights = np.array([[1.0, 0.0, -1.0], [-1.0, 0.0, -1.0], [0.0, 0.0, -1.0], [0.0, 1.0, 1.0], [9.0, 0.0, -1.0]])
    boresights /= np.linalg.norm(boresights, axis=1)[:, None]
    turn = np.zeros((5, 3, 3))
    turn[:, :, 0] = boresights
    pose = Pose(position_m=np.tile([0.0, 0.0, 50.0], (5, 1)), velocity_mps=np.zeros((5, 3)), R_world_antenna=turn)
    hits = figures._meet_ground(pose, over_slope)
    # 50 - x = 0.1 x ahead, 50 + x = 0.1 x behind; up, and past the slope's edge, nothing.
    np.testing.assert_allclose(hits[:3, 0], [50 / 1.1, -50 / 0.9, 0.0], atol=1e-3)
    np.testing.assert_allclose(hits[:3, 2], 0.1 * hits[:3, 0], atol=1e-3)
    assert np.isnan(hits[3:]).all()


def test_power_is_in_watts_only_when_the_sent_power_is_known() -> None:
    physical = make_survey(snr_db=None, transmit_power_dbm=10.0, noise_figure_db=12.0)
    assert "(dBW)" in figures.draw_chirp(physical).axes[1].get_ylabel()
    assert "rel. to transmitted" in figures.draw_chirp(make_survey()).axes[1].get_ylabel()


def test_a_notebook_shows_a_figure(survey: Survey) -> None:
    assert figures.draw_dem(survey)._repr_png_().startswith(b"\x89PNG")


def test_the_histogram_is_that_of_lit_cells(survey: Survey) -> None:
    """Half the cells unlit, and only they bear an error of 3 m."""
    unlit = np.zeros(survey.lit.shape, dtype=bool)
    unlit[:, ::2] = True
    height = np.where(unlit, 3.0, survey.error.height_m)
    spoiled = replace(survey, error=replace(survey.error, height_m=height), lit=~unlit)
    histogram = next(a for a in figures.draw_error(spoiled).axes if a.get_title().startswith("Error of lit cells"))
    tallest = max(histogram.patches, key=lambda bar: bar.get_height())
    assert abs(tallest.get_x()) < 0.5
    assert sum(bar.get_height() for bar in histogram.patches if bar.get_x() > 2.5) == 0


@pytest.mark.parametrize("draw", [figures.draw_power, figures.draw_dem, figures.draw_error])
def test_a_warning_stands_over_the_figure_and_covers_nothing(survey: Survey, draw: Callable[[Survey], Figure]) -> None:
    figure = draw(replace(survey, warnings=("most echoes come from [precipitation] $ in front of the ground " * 3,)))
    told = [outline for text, outline in outlines(figure)]
    assert "Warning: most echoes" in figure.get_suptitle()
    assert not any(figure._suptitle.get_window_extent().overlaps(outline) for outline in told)


def tick_texts(axes: Axes) -> tuple[list[str], list[str]]:
    axes.figure.draw_without_rendering()
    return [t.get_text() for t in axes.get_xticklabels()], [t.get_text() for t in axes.get_yticklabels()]


@pytest.mark.parametrize("draw", [draw_environment, figures.draw_power, figures.draw_dem, figures.draw_error])
def test_maps_have_map_coordinates_where_there_are_any(georeferenced: Survey, draw: Callable[..., Figure]) -> None:
    axes = draw(georeferenced).axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("Easting (m)", "Northing (m)")
    east, north = tick_texts(axes)
    assert "747000" in east
    assert "4035000" in north
    assert len(east) <= 5
    local = draw(georeferenced, coordinates=Coordinates.LOCAL).axes[0]
    assert local.get_xlabel() == "East (m)"
    assert "0" in tick_texts(local)[0]


def test_heights_are_those_of_the_datum(georeferenced: Survey) -> None:
    plan, profile = draw_environment(georeferenced).axes
    bar = plan.child_axes[0]
    assert bar.get_ylabel() == profile.get_ylabel() == "Height above datum (m)"
    assert min(float(text) for text in tick_texts(bar)[1]) > 390
    assert "400" in tick_texts(profile)[1]


def test_tick_labels_of_seven_digits_keep_apart(georeferenced: Survey) -> None:
    for draw in (draw_environment, figures.draw_power, figures.draw_dem, figures.draw_error):
        figure = draw(georeferenced)
        figure.draw_without_rendering()
        for axes in figure.axes:
            for labels in (axes.get_xticklabels(), axes.get_yticklabels()):
                shown = [t.get_window_extent() for t in labels if t.get_text()]
                assert not any(a.overlaps(b) for a, b in combinations(shown, 2))


def test_the_environment_has_ground_under_the_whole_flight(survey: Survey) -> None:
    """The map of heights begins where the beam meets the ground, ahead of the radar."""
    plan, profile = draw_environment(survey).axes
    (west, east), (south, north) = plan.get_xlim(), plan.get_ylim()
    left, right, low, high = plan.get_images()[0].get_extent()
    spacing_m = survey.truth.grid.spacing_m
    assert west >= left - spacing_m
    assert right >= east - spacing_m
    assert south >= low - spacing_m
    assert high >= north - spacing_m
    ground = profile.get_lines()[0]
    flown = survey.schedule.trajectory.position(np.linspace(0.0, survey.schedule.trajectory.end_s, 2000))
    expected = survey.prepared.world.caster.from_above(flown[:, :2], 1e3)
    np.testing.assert_allclose(ground.get_ydata()[: len(flown)], expected, atol=0.5, equal_nan=True)
