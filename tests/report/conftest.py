"""The survey by hand, the same one on the map, and one that detected nothing."""

from dataclasses import replace

import pytest
from pyproj import CRS

from sionna_radar.foundation.georeference import Georeference
from sionna_radar.survey.result import Survey
from surveys import make_empty, make_survey


@pytest.fixture(scope="session")
def survey() -> Survey:
    return make_survey()


@pytest.fixture(scope="session")
def georeferenced(survey: Survey) -> Survey:
    place = Georeference(crs_wkt=CRS.from_epsg(32616).to_wkt(), origin_m=(747_000.0, 4_035_000.0, 400.0))
    built = survey.prepared.scene
    built = replace(built, scene=replace(built.scene, georeference=place))
    return replace(survey, prepared=replace(survey.prepared, scene=built))


@pytest.fixture(scope="session")
def empty(survey: Survey) -> Survey:
    return make_empty(survey)
