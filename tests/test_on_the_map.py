"""A survey over an elevation file with a place on the Earth: its products fit the file, cell by cell."""

from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio import Affine
from rasterio.windows import from_bounds
from scipy.ndimage import gaussian_filter

from sionna_radar.georeference import Georeference, MapCells
from sionna_radar.report import products
from sionna_radar.report.products import write_products
from sionna_radar.scenario import Scenario, parse_scenario
from sionna_radar.survey import run

# Neither a whole number nor at a cell's middle: nothing lines up by chance.
WEST, NORTH = 450_000.37, 5_000_100.61


def write_file(path: Path, cell_m: float = 1.0, crs: str = "EPSG:32632", span_m: float = 240.0) -> Path:
    cells = round(span_m / cell_m)
    noise = gaussian_filter(np.random.default_rng(0).normal(size=(cells, cells)), 15 / cell_m, mode="wrap")
    height = (300 + 2 * noise / noise.std()).astype(np.float32)
    transform = Affine(cell_m, 0.0, WEST, 0.0, -cell_m, NORTH)
    profile = {"driver": "GTiff", "dtype": "float32", "count": 1, "height": cells, "width": cells}
    with rasterio.open(path, "w", crs=crs, transform=transform, **profile) as file:
        file.write(height, 1)
    return path


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


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(products, "draw_all", lambda *_: [])


@pytest.mark.usefixtures("no_figures")
@pytest.mark.parametrize(("cell_m", "spacing_m"), [(1.0, 1.0), (2.0, 1.0), (1.0, 3.0)])
def test_input_and_output_subtract_cell_by_cell(tmp_path: Path, cell_m: float, spacing_m: float) -> None:
    source = write_file(tmp_path / "in.tif", cell_m)
    write_products(run(scenario_over(source, dem={"spacing_m": spacing_m})), tmp_path / "out")
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
