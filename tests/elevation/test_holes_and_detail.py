"""Holes of a raster, and detail below its spacing."""

import logging

import numpy as np
import pytest

from sionna_radar.elevation.file_heights import between_data, detail_on, treat_holes
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.raster import Grid, Raster


def grid_of(rows: int, columns: int, spacing_m: float = 1.0, west_m: float = 0.0, south_m: float = 0.0) -> Grid:
    return Grid(west_m=west_m, south_m=south_m, spacing_m=spacing_m, columns=columns, rows=rows)


def slope_with(*holes: tuple[slice, slice]) -> Raster:
    grid = grid_of(40, 50)
    height = 0.5 * grid.centres_m[:, 0].reshape(grid.shape)
    for hole in holes:
        height[hole] = np.nan
    return Raster(grid=grid, height_m=height)


def test_what_lies_between_data_is_a_hole():
    lake, corner, bay = (slice(10, 15), slice(20, 26)), (slice(0, 8), slice(0, 8)), (slice(35, 40), slice(30, 33))
    filled = slope_with(lake, corner, bay).filled
    holes = between_data(filled)
    assert holes[lake].all()
    assert holes[bay].all()  # cut by the border, with land on both sides
    assert not holes[corner].any()
    assert holes.sum() == 5 * 6 + 5 * 3


def test_a_filled_hole_continues_what_is_around_it(caplog):
    lake = (slice(10, 15), slice(20, 26))
    with caplog.at_level(logging.WARNING, "sionna_radar"):
        raster = treat_holes(slope_with(lake), "fill")
    assert "30 cells without data (1.50 %) are filled" in caplog.text
    truth = slope_with()
    np.testing.assert_allclose(raster.height_m[lake], truth.height_m[lake], atol=0.8)
    outside = slope_with(lake).filled
    np.testing.assert_array_equal(raster.height_m[outside], truth.height_m[outside])


def test_holes_are_kept_or_refused_as_asked():
    lake = (slice(10, 15), slice(20, 26))
    assert treat_holes(slope_with(lake), "keep").filled.sum() == 40 * 50 - 30
    with pytest.raises(ScenarioError, match=r"terrain.holes: 'refuse' finds 30 cells .* the first at \(20.0, 10.0\)"):
        treat_holes(slope_with(lake), "refuse")
    assert treat_holes(slope_with(), "refuse").filled.all()


@pytest.mark.parametrize("hurst", [0.3, 0.8])
def test_detail_has_its_spectrum(hurst):
    """RMS as asked, nothing above two posts of wavelength, and k^-(2 H + 2) below."""
    post = 10.0
    detail = detail_on(grid_of(512, 512, 0.5), post, hurst, 0.3, seed=4)
    assert detail.std() == pytest.approx(0.3, rel=0.1)
    power = np.abs(np.fft.fft2(detail * np.outer(np.hanning(512), np.hanning(512)))) ** 2
    wave = np.hypot(np.fft.fftfreq(512, 0.5)[:, None], np.fft.fftfreq(512, 0.5)[None])
    assert power[wave < 0.8 / (2 * post)].sum() < 0.02 * power.sum()
    bands = [(0.12, 0.15), (0.5, 0.6)]
    level = [power[(wave > low) & (wave < high)].mean() for low, high in bands]
    middle = [np.sqrt(low * high) for low, high in bands]
    slope = np.log(level[1] / level[0]) / np.log(middle[1] / middle[0])
    assert slope == pytest.approx(-(2 * hurst + 2), abs=0.35)


def test_detail_depends_on_the_place_alone():
    whole = detail_on(grid_of(300, 400, 0.5, west_m=-40.0, south_m=12.0), 5.0, 0.7, 1.0, seed=2)
    part = detail_on(grid_of(80, 60, 0.5, west_m=-40.0 + 35.0, south_m=12.0 + 20.0), 5.0, 0.7, 1.0, seed=2)
    np.testing.assert_allclose(part, whole[40:120, 70:130], atol=1e-9)
    other = detail_on(grid_of(80, 60, 0.5), 5.0, 0.7, 1.0, seed=3)
    assert abs(np.corrcoef(part.ravel(), other.ravel())[0, 1]) < 0.1


def test_coarse_cells_have_no_detail():
    with pytest.raises(ScenarioError, match=r"terrain.roughen: cells of 4 m .* set terrain.spacing_m = 1.2 or less"):
        detail_on(grid_of(10, 10, 4.0), 5.0, 0.7, 1.0, seed=1)
