"""The survey by hand, the same one on the map, one that detected nothing, and folders of results of two."""

from dataclasses import replace
from pathlib import Path

import pytest
from pyproj import CRS

from sionna_radar.accuracy.compare import difference, summarise
from sionna_radar.foundation.raster import Georeference, Raster
from sionna_radar.report.files.contents import Report
from sionna_radar.report.survey.products import write_survey
from sionna_radar.studies.comparison.results import read_results
from sionna_radar.studies.comparison.study import FlownResult
from sionna_radar.survey.result import Survey
from surveys import make_empty, make_survey


@pytest.fixture(scope="session")
def survey() -> Survey:
    return make_survey()


@pytest.fixture(scope="session")
def georeferenced(survey: Survey) -> Survey:
    place = Georeference(crs_wkt=CRS.from_epsg(32616).to_wkt(), origin_m=(747_000.0, 4_035_000.0, 400.0))
    world = survey.prepared.world
    world = replace(world, scene=replace(world.scene, georeference=place))
    placed = {
        name: replace(raster, grid=replace(raster.grid, georeference=place))
        for name, raster in vars(survey).items()
        if isinstance(raster, Raster)
    }
    return replace(survey, prepared=replace(survey.prepared, world=world), **placed)


@pytest.fixture(scope="session")
def empty(survey: Survey) -> Survey:
    return make_empty(survey)


@pytest.fixture(scope="session")
def folders(survey: Survey, tmp_path_factory) -> list[Path]:
    """Results of the survey by hand, and of one with other settings whose DEM is a decimetre higher."""
    parent = tmp_path_factory.mktemp("folders")
    radar = survey.scenario.radar.model_copy(update={"chirp_rate_hz": 720.0})
    scenario = survey.scenario.model_copy(update={"seed": 8, "radar": radar})
    raised = replace(survey.dem, height_m=survey.dem.height_m + 0.1)
    error = difference(raised, survey.truth)
    other = replace(
        survey,
        prepared=replace(survey.prepared, scenario=scenario),
        dem=raised,
        error=error,
        lit_error=summarise(error, survey.lit),
    )
    for name, one in (("first", survey), ("second", other)):
        write_survey(one, parent / name, report=Report.NONE)
    return [parent / "first", parent / "second"]


@pytest.fixture(scope="session")
def results(folders: list[Path]) -> list[FlownResult]:
    return read_results(folders)
