"""Fusion: closed forms of shared errors, ground drawn from a prior, planted contradictions, files and refusals."""

import json
import shutil

import laspy
import numpy as np
import pytest
import rasterio
from pyproj import CRS
from scipy.optimize import brentq

from elevation_files import from_origin, write_heights
from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.inference.terrain.covariance import Covariance
from sionna_radar.report.files.contents import Report
from sionna_radar.report.survey.processed import processed_document
from sionna_radar.report.survey.products import write_survey
from sionna_radar.studies.fusion.consistency import GriddedSource, compared
from sionna_radar.studies.fusion.shared_errors import SharedErrors
from sionna_radar.studies.fusion.sources import Source
from sionna_radar.studies.fusion.study import fuse, fuse_sources, majority, on_grid
from sionna_radar.survey.chain import run
from sionna_radar.survey.reprocessing import process
from surveys import hills

CELLS, PRIOR = 120, Covariance(1.5, 20.0, 1.0)
GRID = Grid(west_m=0.5, south_m=0.5, spacing_m=1.0, columns=CELLS, rows=CELLS)


def waves(cells=CELLS):
    north, east = 2 * np.pi * np.fft.fftfreq(cells)[:, None], 2 * np.pi * np.fft.rfftfreq(cells)[None]
    return np.hypot(east, north)


def posterior_power(prior, sigma_m):
    """Power left of each wave by the white information that leaves the variance of a periodic grid, by search."""
    whole = np.broadcast_to(prior, (CELLS, CELLS))

    def excess(log_information):
        return np.mean(whole / (1 + np.exp(log_information) * whole)) - sigma_m**2

    return whole / (1 + np.exp(brentq(excess, -30.0, 30.0)) * whole)


def drawn(sigmas_m, seed=0):
    """Ground of the prior on a periodic grid, and its Wiener estimates from white noise, of standard deviations."""
    rng, prior = np.random.default_rng(seed), PRIOR.spectrum_root(GRID) ** 2
    white = np.fft.rfft2(rng.standard_normal((CELLS, CELLS)))
    ground = np.fft.irfft2(np.sqrt(prior) * white, s=(CELLS, CELLS))
    full = np.fft.fft2(np.fft.irfft2(prior, s=(CELLS, CELLS))).real
    estimates = []
    for sigma_m in sigmas_m:
        left = posterior_power(full, sigma_m)[:, : CELLS // 2 + 1]
        information = 1 / left - 1 / prior
        noise = np.fft.rfft2(rng.standard_normal((CELLS, CELLS))) / np.sqrt(information)
        estimates.append(np.fft.irfft2(left * information * (np.fft.rfft2(ground) + noise), s=(CELLS, CELLS)))
    return ground, estimates


def source(name, height_m, sigma_m, **more) -> Source:
    dem = Raster(grid=GRID, height_m=np.asarray(height_m, dtype=float))
    sigma = np.broadcast_to(np.asarray(sigma_m, dtype=float), dem.grid.shape)
    return Source(name=name, kind="raster", crs=None, extent_m=GRID.extent_m, dem=dem, sigma_m=sigma, **more)


def fused(*sources, **more):
    return fuse_sources(sources, GRID, None, 0.0, **more)


def rms(values):
    return float(np.sqrt(np.nanmean(values**2)))


@pytest.mark.parametrize("smoothness", [0.5, 1.0, 1.6, 3.0])
def test_equal_maps_of_power_law_ground_have_errors_correlated_by_one_over_smoothness_plus_one(smoothness):
    errors = SharedErrors(Covariance(smoothness, 400.0, 100.0), 1.0, (0.02, 0.2))
    sigma_m = np.array([0.05, 0.1])
    correlation = errors.covariance_m2(sigma_m, sigma_m) / sigma_m**2
    np.testing.assert_allclose(correlation, 1 / (smoothness + 1), rtol=0.04)


def test_second_moments_are_those_of_a_plain_sum_over_the_waves_of_a_grid():
    errors, prior = SharedErrors(PRIOR, 1.0, (0.04, 0.3)), PRIOR.spectrum_root(GRID) ** 2
    full = np.fft.fft2(np.fft.irfft2(prior, s=GRID.shape)).real
    one, other = posterior_power(full, 0.05), posterior_power(full, 0.2)
    axis = 2 * np.pi * np.fft.fftfreq(CELLS)
    passed = np.exp(-(axis[:, None] ** 2 + axis**2) * 25 / 12)
    of_means = np.mean((one + other - 2 * one * other / full) * passed)
    # The grid has neither waves longer than itself nor shorter than two cells.
    sigma_m = np.array([0.05]), np.array([0.2])
    assert errors.covariance_m2(*sigma_m)[0] == pytest.approx(np.mean(one * other / full), rel=0.05)
    assert errors.mean_variance_m2(*sigma_m, 5.0)[0] == pytest.approx(of_means, rel=0.05)


def test_a_fused_map_is_better_than_each_and_its_intervals_hold():
    sigmas_m, missing = (0.1, 0.12), slice(0, 30)
    square, stated, held, alone = 0.0, 0.0, np.zeros(2), []
    for seed in range(3):
        ground, (one, other) = drawn(sigmas_m, seed)
        other[missing] = np.nan
        result = fused(source("a", one, sigmas_m[0]), source("b", other, sigmas_m[1]))
        error, both = result.dem.height_m - ground, result.source.height_m == 3
        assert result.legend == {1: "a", 3: "a + b"}
        assert not result.contradictions.filled.any()
        np.testing.assert_allclose(result.dem.height_m[missing], one[missing], atol=1e-12)
        np.testing.assert_allclose(result.sigma.height_m[missing], sigmas_m[0])
        square += np.mean(error[both] ** 2) / 3
        stated += np.mean(result.sigma.height_m[both] ** 2) / 3
        ratio = np.abs(error / result.sigma.height_m)[both]
        held += np.array([np.mean(ratio < 1), np.mean(ratio < 1.96)]) / 3
        alone.append(rms((one - ground)[both]))
    assert square == pytest.approx(stated, rel=0.1)
    np.testing.assert_allclose(held, [0.683, 0.95], atol=0.03)
    assert np.sqrt(square) < 0.93 * np.mean(alone)
    # Independent errors would be stated as smaller than they are.
    assert square > 1.15 / (1 / sigmas_m[0] ** 2 + 1 / sigmas_m[1] ** 2)


@pytest.mark.parametrize(("stored", "scale_offset"), [("int16", (0.05, 120.0)), ("uint16", (0.1, -40.0))])
def test_heights_of_a_source_are_those_of_its_scale_and_offset(tmp_path, stored, scale_offset):
    """Whole numbers of decimetres, as of EU-DEM's packed tiles, and -9999 where nothing is declared."""
    ground, heights = drawn((0.1, 0.1), 4)
    plain, packed = (150.0 + height_m[::-1] for height_m in heights)
    packed = np.round((packed - scale_offset[1]) / scale_offset[0]).astype(stored)
    if stored == "int16":
        packed[20:25, 20:25] = -9999
    place = from_origin(0, CELLS, 1, 1)
    write_heights(tmp_path / "plain.tif", plain, place)
    write_heights(tmp_path / "packed.tif", packed, place, scale_offset=scale_offset)
    fusion = fuse([tmp_path / "plain.tif", tmp_path / "packed.tif"], sigma_m=0.1)
    assert fusion.warnings == []
    assert rms(fusion.dem.height_m - 150.0 - ground) < 0.12
    assert (fusion.dem.filled & (fusion.source.height_m == 3)).sum() == (packed.astype(int) != -9999).sum()


def test_heights_between_the_cells_of_a_source_err_by_what_the_prior_leaves_open():
    """Ground of the prior, sampled in every third cell: bilinear heights between hold what is stated."""
    ratios = []
    for seed in range(3):
        ground, _ = drawn((0.1,), seed + 40)
        coarse = Grid(west_m=GRID.west_m, south_m=GRID.south_m, spacing_m=3.0, columns=CELLS // 3, rows=CELLS // 3)
        own = Raster(grid=coarse, height_m=ground[::3, ::3])
        made = Source(
            name="a", kind="raster", crs=None, extent_m=coarse.extent_m, dem=own, sigma_m=np.full(coarse.shape, 1e-3)
        )
        there = on_grid(made, GRID, prior=PRIOR)
        between = there.dem.filled & (there.sigma_m > 2e-3)
        np.testing.assert_allclose(there.dem.height_m[:-2:3, :-2:3], ground[:-2:3, :-2:3], atol=1e-9)
        np.testing.assert_allclose(there.sigma_m[:-2:3, :-2:3], 1e-3)
        ratios.append(((there.dem.height_m - ground) / there.sigma_m)[between])
    assert np.std(ratios) == pytest.approx(1.0, abs=0.1)


def test_consistent_sources_are_not_accused():
    errors = SharedErrors(PRIOR, 1.0, (0.09, 0.13))
    for seed in range(6):
        _, heights = drawn((0.1, 0.12), seed + 10)
        made = [
            GriddedSource(
                name=name,
                kind="raster",
                dem=Raster(grid=GRID, height_m=height_m),
                sigma_m=np.full(GRID.shape, sigma_m),
                common_m=np.zeros(GRID.shape),
            )
            for name, height_m, sigma_m in zip("ab", heights, (0.1, 0.12), strict=True)
        ]
        pair, apart = compared(*made, errors, 1)
        assert pair.findings == []
        assert not apart.any()
        assert pair.chi2 == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize(
    ("planted", "finding"),
    [(np.full(GRID.shape, 0.5), "offset"), (0.01 * (GRID.x_m[None] - 60) + 0 * GRID.y_m[:, None], "tilt")],
    ids=["offset", "tilt"],
)
def test_a_planted_shift_is_named_and_the_majority_makes_the_map(planted, finding):
    ground, (one, other, third) = drawn((0.05, 0.05, 0.05))
    shifted = source("shifted", other + planted, 0.05)
    result = fused(source("a", one, 0.05), shifted, source("c", third, 0.05))
    assert result.suspect == "shifted"
    for pair in result.pairs:
        assert ("shifted" in {pair.first, pair.second}) == any(finding in text for text in pair.findings)
    assert any("shifted is shifted against the other sources" in text for text in result.warnings)
    assert result.left_empty == 0
    assert rms((result.dem.height_m - ground)[np.abs(planted) > 0.3]) < 0.06
    # Of two sources neither has a majority: what contradicts is empty, and shown.
    alone = fused(source("a", one, 0.05), shifted)
    assert alone.suspect is None
    clear = np.abs(planted) > 0.4
    assert not alone.dem.filled[clear].any()
    assert alone.contradictions.filled[clear].all()
    assert np.nanmean(alone.contradictions.height_m[clear]) == pytest.approx(np.abs(planted[clear]).mean(), rel=0.1)
    # Unless it is known which one is right.
    aligned = fused(source("a", one, 0.05), shifted, reference=0)
    assert aligned.dem.filled.all()
    assert rms(aligned.dem.height_m - ground) < 0.06
    assert aligned.sources[1].moved is not None


def test_a_local_contradiction_is_cut_out_and_the_rest_is_fused():
    _, (one, other) = drawn((0.05, 0.05))
    other[40:52, 70:82] += 0.6
    result = fused(source("a", one, 0.05), source("b", other, 0.05))
    assert not result.dem.filled[42:50, 72:80].any()
    far = np.ones(GRID.shape, dtype=bool)
    far[34:58, 64:88] = False
    assert (result.source.height_m[far] == 3).all()


def test_scatter_beyond_what_is_stated_widens_the_fused_sigma():
    _, (one, other) = drawn((0.1, 0.1))
    narrow = fused(source("a", one, 0.04), source("b", other, 0.04))
    assert narrow.pairs[0].scatter == pytest.approx(2.5, rel=0.3)
    assert np.nanmedian(narrow.sigma.height_m) > 0.05


def test_errors_of_navigation_explain_an_offset():
    _, (one, other) = drawn((0.05, 0.05))
    explained = source("b", other + 0.3, 0.05, navigation_m=np.full(GRID.shape, 0.4))
    result = fused(source("a", one, 0.05), explained)
    assert result.pairs[0].findings == []
    assert np.nanmedian(np.abs(result.dem.height_m - one)) < 0.02


@pytest.mark.parametrize(
    ("present", "against", "chosen"),
    [
        ([0, 1], set(), (0, 1)),
        ([0, 1], {(0, 1)}, ()),
        ([0, 1, 2], {(0, 1), (1, 2)}, (0, 2)),
        ([0, 1, 2], {(0, 1)}, ()),
        ([0, 1, 2, 3], {(0, 2), (0, 3), (1, 2), (1, 3)}, ()),
        ([2], set(), (2,)),
    ],
)
def test_the_majority_is_the_only_largest_set_that_agrees(present, against, chosen):
    assert majority(present, against) == chosen


# ---------------------------------------------------------------------------------------------------------- files
def write_dem(folder, name, height_m, sigma_m=0.05, crs="EPSG:32632", west=500_000.0, north=5_000_120.0, **more):
    """Write a DEM of rows from south to north, with its sigma beside it."""
    transform = from_origin(west, north, 1.0, 1.0)
    path = write_heights(folder / f"{name}.tif", height_m[::-1].astype(np.float32), transform, crs, **more)
    if sigma_m is not None:
        sigma = np.full(height_m.shape, sigma_m, dtype=np.float32)
        write_heights(folder / f"{name}_sigma.tif", sigma, transform, crs)
    return path


def write_cloud(path, place_m, height_m, sigma_m=None, crs="EPSG:32632"):
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = np.full(3, 1e-4), np.array([500_000.0, 5_000_000.0, 0.0])
    header.add_crs(CRS(crs))
    if sigma_m is not None:
        header.add_extra_dim(laspy.ExtraBytesParams(name="range_sigma_m", type="float32"))
    cloud = laspy.LasData(header)
    cloud.x, cloud.y = (place_m + header.offsets[:2]).T
    cloud.z = height_m
    cloud.return_number = np.ones(len(height_m), dtype=np.uint8)
    if sigma_m is not None:
        cloud["range_sigma_m"] = np.full(len(height_m), sigma_m, dtype=np.float32)
    cloud.write(path)
    return path


def test_the_order_of_sources_has_no_effect_and_all_kinds_of_files_are_read(tmp_path):
    ground, (one, other) = drawn((0.05, 0.08))
    one[:, 90:] = np.nan
    rng = np.random.default_rng(5)
    place_m = rng.uniform(75, 107, (300, 2))
    height_m = Raster(grid=GRID, height_m=ground).at(place_m) + 0.02 * rng.standard_normal(300)
    inside = np.isfinite(height_m)
    paths = [
        write_dem(tmp_path, "one", one),
        write_dem(tmp_path, "other", other, None),
        write_cloud(tmp_path / "cloud.las", place_m[inside], height_m[inside], 0.02),
    ]
    results = [fuse(order, sigma_m=0.08) for order in (paths, paths[::-1])]
    for result in results[1:]:
        for name in ("dem", "sigma", "source", "contradictions"):
            np.testing.assert_array_equal(getattr(result, name).height_m, getattr(results[0], name).height_m)
    assert [each.name for each in results[0].sources] == ["cloud.las", "one.tif", "other.tif"]
    assert all(pair.findings == [] for pair in results[0].pairs)
    error = results[0].dem.height_m - ground
    with_cloud = np.isin(results[0].source.height_m, [5, 7])
    assert with_cloud.sum() > 300
    assert rms(error[with_cloud]) < rms((other - ground)[with_cloud])
    assert rms(error) < min(rms(other - ground), 0.08)


def test_the_command_writes_rasters_with_a_legend_numbers_and_page(cli, tmp_path):
    _, (one, other) = drawn((0.05, 0.05))
    one[:50, :50] = np.nan
    write_dem(tmp_path, "radar", one)
    write_dem(tmp_path, "lidar", other, None)
    said = cli(
        "fuse", tmp_path / "radar.tif", tmp_path / "lidar.tif", "--sigma", f"{tmp_path / 'lidar.tif'}=0.05",
        "-o", tmp_path / "out",
    ).stdout  # fmt: skip
    assert "agree" in said
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {
        *("dem.tif", "dem_sigma.tif", "source.tif", "contradictions.tif"),
        *("fuse.json", "report.html", "manifest.json"),
    }
    numbers = json.loads((tmp_path / "out" / "fuse.json").read_text())
    assert numbers["legend"] == {"1": "lidar.tif", "3": "lidar.tif + radar.tif"}
    assert numbers["cells_by_source"]["lidar.tif"] == 2500
    with rasterio.open(tmp_path / "out" / "source.tif") as file:
        assert file.crs.to_epsg() == 32632
        assert file.tags()["SOURCE_1"] == "lidar.tif"
        assert (file.read(1)[::-1][:50, :50] == 1).all()
    # The folder is read again as a survey is.
    again = fuse([tmp_path / "out", write_dem(tmp_path, "third", drawn((0.05,))[1][0])])
    assert [each.kind for each in again.sources] == ["survey", "raster"]


HELD_TWICE = {
    "one.tif": "'one.tif', as 'one.tif' does",
    "copy.tif": "'one.tif', as 'copy.tif' does",
    "other_fusion": "'one.tif', as 'other_fusion' does",
    "fusion_of_fusion": "as 'fusion_of_fusion' does",
    "fusion/dem.tif": "'dem.tif', as 'fusion' does",
}


def test_a_fusion_beside_a_source_that_it_holds_is_refused(cli, tmp_path):
    """Counted twice, it would be given twice its weight."""
    _, heights = drawn((0.05, 0.06, 0.07, 0.08))
    one, two, three, four = (
        write_dem(tmp_path, name, heights[n]) for n, name in enumerate(["one", "two", "three", "four"])
    )
    shutil.copy(one, tmp_path / "copy.tif")
    shutil.copy(tmp_path / "one_sigma.tif", tmp_path / "copy_sigma.tif")
    for folder, sources in {
        "fusion": [one, two],
        "other_fusion": [one, three],
        "fusion_of_fusion": [tmp_path / "fusion", four],
    }.items():
        cli("fuse", *sources, "-o", tmp_path / folder, "--no-report")
    for second, named in HELD_TWICE.items():
        said = cli("fuse", tmp_path / "fusion", tmp_path / second, "-o", tmp_path / "out", code=2).stderr
        said = " ".join(said.split())
        assert "is a fusion that holds " in said
        assert named in said
        assert not (tmp_path / "out").exists()
    fuse([tmp_path / "fusion", three])  # what it does not hold is taken


def test_a_record_that_does_not_tell_its_files_is_warned_of_and_a_damaged_one_refused(cli, tmp_path, caplog):
    _, (one, two) = drawn((0.05, 0.06))
    paths = [write_dem(tmp_path, "one", one), write_dem(tmp_path, "two", two)]
    cli("fuse", *paths, "-o", tmp_path / "fusion", "--no-report")
    record = tmp_path / "fusion" / "fuse.json"
    numbers = json.loads(record.read_text())
    for source in numbers["sources"]:
        del source["made_of"]
    record.write_text(json.dumps(numbers))
    third = write_dem(tmp_path, "third", two + 0.01)
    fuse([tmp_path / "fusion", third])
    assert any("does not tell the files that it was made of" in message for message in caplog.messages)
    for damaged in ("[]", "{}", '{"sources": 3}', '{"sources": ["a"]}', '{"sources": [{"made_of": 3}]}', "no JSON"):
        record.write_text(damaged)
        with pytest.raises(InputFileError, match="holds no sources of a fusion"):
            fuse([tmp_path / "fusion", third])


def test_recordings_and_folders_are_sources(tmp_path):
    survey = run(hills(dem__method="smooth", platform__length_m=5.0), recordings={"signals": tmp_path / "flight.nc"})
    write_survey(survey, tmp_path / "flown", report=Report.NONE, points=[])
    result = fuse([tmp_path / "flown", tmp_path / "flight.nc"], overrides={"dem.spacing_m": 1.0})
    assert [(each.name, each.kind) for each in result.sources] == [("flight.nc", "recording"), ("flown", "survey")]
    assert result.covariance.microrelief_m == 0  # both know that their ground is simulated
    processed_document().write(process(tmp_path / "flight.nc"), tmp_path / "processed")
    assert fuse([tmp_path / "flown", tmp_path / "processed"]).covariance.microrelief_m == 0
    assert result.pairs[0].findings == []
    filled = survey.dem.filled & result.dem.filled[: survey.dem.grid.rows, : survey.dem.grid.columns]
    assert filled.sum() == survey.dem.filled.sum()
    np.testing.assert_allclose(result.dem.height_m[filled], survey.dem.height_m[filled], atol=1e-5)


def folder_of(tmp_path, height_m):
    """Return a folder of a survey's DEM."""
    (tmp_path / "flown").mkdir()
    return write_dem(tmp_path / "flown", "dem", height_m).parent


def _refused(tmp_path, case):
    """Return the arguments of a case that is refused."""
    height_m = drawn((0.05,))[0]
    one = write_dem(tmp_path, "one", height_m)
    made = {
        "no sigma": lambda: [one, write_dem(tmp_path, "other", height_m, None)],
        "map": lambda: [one, write_dem(tmp_path, "other", height_m, crs="EPSG:23032")],
        "vertical": lambda: [
            write_dem(tmp_path, "heights", height_m, crs="EPSG:32632+5773"),
            write_dem(tmp_path, "other", height_m, crs="EPSG:32632+3855"),
        ],
        "no crs": lambda: [one, write_dem(tmp_path, "other", height_m, crs=None)],
        "degrees": lambda: [
            write_dem(tmp_path, name, height_m, crs="EPSG:4326", west=9.0, north=45.0) for name in ("d", "e")
        ],
        "apart": lambda: [one, write_dem(tmp_path, "other", height_m, west=500_400.0)],
        "alone": lambda: [one],
        "twice": lambda: [one, tmp_path / "." / "one.tif"],
        "missing": lambda: [one, tmp_path / "nothing.tif"],
        "unreadable": lambda: [one, one.with_name("one.txt")],
        "empty folder": lambda: [one, tmp_path],
        "cells": lambda: [one, write_dem(tmp_path, "other", height_m)],
        "unknown": lambda: [one, write_dem(tmp_path, "other", height_m), "--align-to", "third.tif"],
        "number": lambda: [one, write_dem(tmp_path, "other", height_m), "--sigma", "small"],
        "negative": lambda: [one, write_dem(tmp_path, "other", height_m), "--sigma", "-1"],
        "zero": lambda: [one, write_dem(tmp_path, "other", height_m, 0.0)],
        "cloud": lambda: [write_cloud(tmp_path / f"{n}.las", GRID.centres_m, height_m.ravel(), 0.1) for n in "ab"],
        "of folder": lambda: [one, folder_of(tmp_path, height_m), "--sigma", f"{tmp_path / 'flown'}=0.1"],
        "set": lambda: [one, write_dem(tmp_path, "other", height_m), "--set", "dem.spacing_m=2"],
    }[case]()
    if case == "unreadable":
        made[1].write_text("no heights")
    if case == "cells":
        write_heights(tmp_path / "other_sigma.tif", np.ones((5, 5), np.float32), from_origin(7, 9, 1.0, 1.0))
    return made


def test_copies_of_one_map_are_named(tmp_path):
    _, (one, other) = drawn((0.05, 0.08))
    one[:, 90:] = np.nan
    sources = [write_dem(tmp_path, name, of) for name, of in (("one", one), ("again", one + 0.0), ("other", other))]
    found = [warning for warning in fuse(sources).warnings if "the same heights" in warning]
    assert len(found) == 1
    assert found[0].startswith("again.tif and one.tif hold the same heights in all ")


@pytest.mark.parametrize(
    ("case", "message"),
    [
        ("no sigma", "no standard deviation: no other_sigma.tif is beside it; write one, or state it with --sigma"),
        ("map", "is in 'ED50 / UTM zone 32N', and one.tif in 'WGS 84 / UTM zone 32N'; convert one with gdalwarp"),
        ("vertical", "heights count from EGM2008 geoid, and those of heights.tif from EGM96 geoid; convert one"),
        ("no crs", "has no CRS, and one.tif has one; add it with gdal_translate -a_srs"),
        ("degrees", "is in 'WGS 84', not in metres; convert all"),
        ("apart", "has no cell in common with another source; it covers x = 500000 to"),
        ("alone", "SOURCE: 1 sources; give 2 to 12"),
        ("twice", "the same source is given twice"),
        ("missing", "nothing.tif does not exist"),
        ("unreadable", "one.txt cannot be read as a raster"),
        ("empty folder", "holds no dem.tif with its dem_sigma.tif"),
        ("cells", "other_sigma.tif has other cells than its DEM"),
        ("unknown", "--align-to: 'third.tif' is no source"),
        ("number", "--sigma: 'small' is no standard deviation"),
        ("negative", "--sigma: -1 must be greater than 0"),
        ("zero", "other_sigma.tif states a standard deviation of zero or none for each height; give them in m"),
        ("cloud", "--spacing: missing, and no source is a raster"),
        ("set", "--set: no source is a recording"),
        ("of folder", "flown has a standard deviation for each cell; leave it out"),
    ],
)
def test_sources_that_cannot_be_fused_are_refused_and_nothing_is_written(cli, tmp_path, case, message):
    said = cli("fuse", *_refused(tmp_path, case), "-o", tmp_path / "out", code=2).stderr
    assert message in " ".join(said.split())
    assert not (tmp_path / "out").exists()
