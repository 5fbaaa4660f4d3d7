"""Every part of a survey can be replaced from Python, and does what the same part of a scenario does."""

import dataclasses
import re

import numpy as np
import pytest

from sionna_radar import CustomParts, load_scenario, prepare, run
from sionna_radar.detection.ranging.estimators import PeakRange
from sionna_radar.flight.scan import RotatingScan
from sionna_radar.foundation.errors import RadarError
from sionna_radar.mapping.refined.refinement import Smooth
from sionna_radar.radar.build import build_antenna
from sionna_radar.scenario.tracing import TracingTable
from sionna_radar.scene.terrains.build import build_landscape
from sionna_radar.surfaces.backscatter import ConstantGammaBackscatter
from sionna_radar.survey.sensors.lidar import Lidar
from sionna_radar.tracing.build import build_engine

SHORT = {"platform.length_m": 8.0, "terrain.spacing_m": 2.0, "tracing.paths_per_pulse": 64}


def conical() -> RotatingScan:
    return RotatingScan(
        mode="conical",
        incidence_rad=float(np.deg2rad(30.0)),
        half_swath_rad=float(np.deg2rad(40.0)),
        rotation_rad_s=2 * np.pi * 2.0,
        start_rad=0.0,
        stabilised=True,
    )


def gamma_engine(given):
    return build_engine(TracingTable(engine="gamma"), given)


def noisy_lidar(given):
    return Lidar(given.engine.caster, 0.1, given.engine.seed)


def other_hills(given):
    return build_landscape(load_scenario("hills", SHORT | {"terrain.seed": 9}).terrain, given)


# A part given from Python, and the same part by name.
SAME = {
    "antenna": (
        {"antenna": build_antenna(load_scenario("hills", {"radar.antenna.beamwidth_deg": 4.0}).radar.antenna)},
        {"radar.antenna.beamwidth_deg": 4.0},
    ),
    "scan": (
        {"scan": conical()},
        {"radar.scan": {"mode": "conical", "incidence_deg": 30.0, "half_swath_deg": 40.0}},
    ),
    "range_estimator": ({"range_estimator": PeakRange()}, {"processing.ranging": "peak"}),
    "dem_method": ({"dem_method": Smooth()}, {"dem.method": "smooth"}),
    "engine": ({"engine": gamma_engine}, {"tracing.engine": "gamma"}),
    "sensor": ({"sensor": noisy_lidar}, {"sensor": "lidar", "lidar.range_noise_m": 0.1}),
    "terrain": ({"terrain": other_hills}, {"terrain.seed": 9}),
    "materials": (
        {"materials": {"ground": ConstantGammaBackscatter(10 ** (-2.0))}},
        {"materials.ground": {"model": "constant_gamma", "gamma_db": -20.0}},
    ),
}


@pytest.fixture(scope="module")
def plain():
    return run(load_scenario("hills", SHORT))


@pytest.mark.parametrize("part", SAME)
def test_a_part_from_python_is_that_of_the_same_name(part, plain):
    given, overrides = SAME[part]
    custom = run(load_scenario("hills", SHORT), parts=CustomParts(**given))
    named = run(load_scenario("hills", SHORT | overrides))
    np.testing.assert_array_equal(custom.points.position_m, named.points.position_m)
    np.testing.assert_array_equal(custom.dem.height_m, named.dem.height_m)
    assert len(custom.replaced) == 1
    assert named.replaced == {}
    assert not np.array_equal(custom.dem.height_m, plain.dem.height_m, equal_nan=True)


def test_a_custom_scan_has_the_gap_and_the_noise_of_the_same_scan_by_name():
    overrides = {"radar.scan": {"mode": "conical", "incidence_deg": 30.0, "half_swath_deg": 40.0}}
    named = prepare(load_scenario("hills", SHORT | overrides))
    custom = prepare(load_scenario("hills", SHORT), CustomParts(scan=conical()))
    assert custom.mapper.max_gap_m == named.mapper.max_gap_m
    assert custom.receiver.noise_power_w == named.receiver.noise_power_w
    # The scenario's own scan looks 45 deg forward: a weaker echo to refer the noise to.
    own = prepare(load_scenario("hills", SHORT))
    assert own.receiver.noise_power_w < custom.receiver.noise_power_w


def test_a_prepared_survey_has_its_parts_already():
    prepared = prepare(load_scenario("hills", SHORT))
    with pytest.raises(TypeError, match="give them to `prepare`"):
        run(prepared, parts=CustomParts(dem_method=Smooth()))


class Empty:
    """No part of anything."""


class Half:
    """A scan that says neither where nor how far apart its beams look."""

    stabilised = True

    def point(self, time_s): ...


@dataclasses.dataclass
class NoMap:
    """A method that makes no map."""

    profiles: str = "unused"

    def __call__(self, inputs):
        return np.zeros((3, 3))


class Dark:
    """A material without an echo."""

    def sigma0(self, incidence_rad):
        return np.full(len(incidence_rad), np.nan)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("part", "given", "words"),
    [
        ("scan", Half(), "scan = Half is not a valid Scan: it lacks incidence_rad, spacing_m"),
        ("dem_method", Smooth, "dem_method is the class Smooth, not an instance; give Smooth(...)"),
        ("dem_method", Empty(), "dem_method = Empty is not a valid DemMethod: it lacks profiles, __call__"),
        ("navigation", Empty(), "it lacks measure"),
        ("antenna", Empty(), "antenna = Empty is not a valid Antenna"),
        ("range_estimator", 3, "range_estimator = int is not a valid RangeEstimator: it lacks __call__"),
        ("engine", lambda _: Empty(), "engine = Empty is not a valid Engine: it lacks trace"),
        ("sensor", lambda _: None, "sensor = NoneType is not a valid Sensor: it lacks observe, correct, record_chirp"),
        ("terrain", lambda _: None, "terrain = NoneType is not a valid Landscape"),
        ("materials", {"ground": Dark()}, "sigma0 at 0, 30 and 60 deg is [nan nan nan]; return a finite ratio"),
        ("materials", {"nope": Dark()}, "no material of the scenario has this name; give one of building, ground"),
        ("dem_method", NoMap(), "DEM method 'NoMap': return a `Raster` on the requested grid"),
        ("range_estimator", lambda _: None, "return `Ranges` with a finite range for each of the echoes"),
        ("dem_method", NoMap("required"), "dem.method: 'NoMap' needs range profiles, which this sensor does not have"),
    ],
)
def test_a_wrong_part_is_refused_by_its_name(part, given, words):
    """Types are checked at every call of the tests, but not in a user's script."""
    hills = load_scenario("hills", SHORT | {"sensor": "lidar" if given == NoMap("required") else "radar"})
    with pytest.raises(RadarError, match=re.escape(words)):
        run(hills, parts=CustomParts(**{part: given}))


def test_an_engine_gets_what_it_needs_and_not_the_survey():
    prepared = prepare(load_scenario("hills", SHORT))
    names = {field.name for field in dataclasses.fields(prepared.engine_inputs())}
    assert names == {"tracing", "scene", "antenna", "chirp", "seed", "caster", "region_m", "looks", "beams"}
    assert "prepared" not in {field.name for field in dataclasses.fields(prepared.sensor_inputs())}
