"""Text grids, x y z on each line: any order, gaps, several tiles, other separators; and what is no grid."""

from pathlib import Path

import numpy as np
import pytest

from mutants import mutated
from sionna_radar import load_scenario, run
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.raster_file import open_raster
from sionna_radar.foundation.xyz_grid import read_xyz

WEST, SOUTH = 412_000.5, 5_655_000.5


def tile(east: float = 0.0, north: float = 0.0, count: int = 40, step: float = 1.0) -> np.ndarray:
    x, y = np.meshgrid(WEST + east + step * np.arange(count), SOUTH + north + step * np.arange(count))
    return np.column_stack([x.ravel(), y.ravel(), height(x.ravel(), y.ravel())])


def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 200 + 0.05 * (x - WEST) - 0.02 * (y - SOUTH)


def written(path: Path, points: np.ndarray, separator: str = " ", head: str = "", digits: int = 2) -> Path:
    rows = (separator.join(f"{value:.{digits}f}" for value in point) for point in points)
    path.write_text(head + "\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize(("order", "separator", "head"), [
    ("rows", " ", ""), ("columns", "\t", ""), ("shuffled", ", ", "X, Y, Z\n"), ("down", ";", "# DGM1\n"),
])  # fmt: skip
def test_a_grid_is_read_in_any_order(tmp_path, order, separator, head):
    points = tile()
    by = {
        "rows": np.arange(len(points)),
        "columns": np.lexsort((points[:, 1], points[:, 0])),
        "shuffled": np.random.default_rng(1).permutation(len(points)),
        "down": np.lexsort((points[:, 0], -points[:, 1])),
    }
    grid = read_xyz(written(tmp_path / "a.xyz", points[by[order]], separator, head), "terrain.path =")
    assert (grid.west, grid.north) == (WEST, SOUTH + 39)
    assert grid.steps == (1.0, 1.0)
    x, y = np.meshgrid(WEST + np.arange(40), SOUTH + 39 - np.arange(40))
    np.testing.assert_allclose(grid.height, height(x, y), atol=0.006)


def test_gaps_and_several_tiles_stay_where_they_are(tmp_path):
    """Two tiles with a tile's width between them, one with a hole; the second shares a column with nothing."""
    points = np.concatenate([tile(), tile(east=80.0, north=10.0)])
    hole = (np.abs(points[:, 0] - WEST - 20) < 5) & (np.abs(points[:, 1] - SOUTH - 12) < 5)
    with open_raster(written(tmp_path / "two.XYZ", points[~hole]), "terrain.path") as file:
        assert (file.width, file.height, file.crs) == (120, 50, None)
        found = file.read(1)
        row, column = ((SOUTH + 49 - points[:, 1]).astype(int), (points[:, 0] - WEST).astype(int))
        assert file.xy(0, 0) == (WEST, SOUTH + 49)
        np.testing.assert_allclose(found[row, column][~hole], points[~hole, 2], atol=0.006)
        assert np.isnan(found[row, column][hole]).all()
        assert np.count_nonzero(np.isfinite(found)) == np.count_nonzero(~hole)


def test_rounded_distances_do_not_add_up(tmp_path):
    """A third of an arc second with seven decimals: the cells are 0.0000926 or 0.0000925 wide."""
    lon, lat = np.meshgrid(9 + np.arange(900) / 10_800, 50 + np.arange(3) / 10_800)
    points = np.column_stack([lon.ravel(), lat.ravel(), 0 * lon.ravel()])
    grid = read_xyz(written(tmp_path / "a.xyz", points, digits=7), "x")
    assert grid.height.shape == (3, 900)
    assert grid.steps[0] == pytest.approx(1 / 10_800, rel=1e-5)


@pytest.mark.parametrize(("text", "words"), [
    ("1 2 3\n2 2 x\n", "line 2 or after reads '2 2 x'"),
    ("1 2 3\n2 2\n", "line 2 or after reads '2 2'"),
    ("1 2 3\n2 2 3\n", "all points have the same y"),
    ("0 0 1\n1 0 1\n2.4 1 1\n3.1 1 1\n", "the points do not form a grid: x = "),
    ("0 0 1\n1 1 1\n1e9 0 1\n", "do not form a grid"),
    ("0 0 1\n1 1 1\n50000 90000 1\n", "spans 50,001 x 90,001 cells"),
    ("0 0 1\nnan 1 1\n", "a coordinate is not a finite number"),
    ("", "all points have the same x"),
])  # fmt: skip
def test_what_is_no_grid_is_one_error(tmp_path, text, words):
    path = tmp_path / "a.xyz"
    path.write_text(text)
    with pytest.raises(InputFileError) as refused:
        read_xyz(path, "terrain.path =")
    assert words in str(refused.value)


def test_a_survey_flies_over_a_text_grid(tmp_path):
    path = written(tmp_path / "dgm1.xyz", tile(count=110))
    terrain = {"kind": "raster", "path": str(path), "crs": "EPSG:25833"}
    changes = {
        "terrain": terrain,
        "platform.length_m": 2.0,
        "platform.altitude_m": 20.0,
        "platform.start_m": [0.0, 0.0],
    }
    survey = run(load_scenario("hills", changes))
    assert survey.georeference.crs_wkt.startswith('PROJCRS["ETRS89 / UTM zone 33N"')
    east, north, up = survey.georeference.origin_m
    truth = survey.truth
    x, y = truth.grid.centres_m.T
    known = truth.filled.ravel()
    np.testing.assert_allclose((truth.height_m.ravel() + up)[known], height(x + east, y + north)[known], atol=0.01)
    with pytest.raises(ScenarioError, match=r"terrain.crs: missing, and the file has no CRS"):
        run(load_scenario("hills", changes | {"terrain": {"kind": "raster", "path": str(path)}}))


def test_a_damaged_text_grid_is_one_error_or_a_grid(tmp_path):
    whole, generator, read = written(tmp_path / "a.xyz", tile(count=12)).read_bytes(), np.random.default_rng(8), 0
    for _ in range(150):
        (tmp_path / "b.xyz").write_bytes(mutated(whole, generator))
        try:
            grid = read_xyz(tmp_path / "b.xyz", "x")
        except InputFileError:
            continue
        read += 1
        assert grid.height.size <= 100_000_000
    assert 0 < read < 150
