"""Every part of a survey can be replaced from Python, and does what the same part of a scenario does."""

import dataclasses
import subprocess
import sys

import numpy as np
import pytest

from sionna_radar import CustomParts, load_scenario, prepare, run
from sionna_radar.detection.ranging.estimators import PeakRange
from sionna_radar.flight.scan import RotatingScan
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


# What `run` says of wrong parts, past the types, which the tests check at every call and a user's script does not.
WRONG = """
import numpy as np
from sionna_radar import load_scenario, run
from sionna_radar.foundation import RadarError
from sionna_radar.mapping.refined.refinement import Smooth

class Empty:
    pass

class Half:
    stabilised = True
    def point(self, time_s): ...

class NoMap:
    profiles = "unused"
    def __call__(self, given):
        return np.zeros((3, 3))

class Greedy(NoMap):
    profiles = "required"

class Dark:
    def sigma0(self, incidence_rad):
        return np.full(len(incidence_rad), np.nan)

hills = load_scenario("hills", {"platform.length_m": 8.0, "terrain.spacing_m": 2.0, "tracing.paths_per_pulse": 64})
lidar = hills.model_copy(update={"sensor": "lidar"})
for scenario, given in (
    (hills, {"scan": Half()}),
    (hills, {"dem_method": Smooth}),
    (hills, {"antenna": Empty()}),
    (hills, {"range_estimator": 3}),
    (hills, {"engine": lambda given: Empty()}),
    (hills, {"sensor": lambda given: None}),
    (hills, {"terrain": lambda given: None}),
    (hills, {"materials": {"ground": Dark()}}),
    (hills, {"materials": {"nope": Dark()}}),
    (hills, {"dem_method": NoMap()}),
    (hills, {"range_estimator": lambda spans: None}),
    (lidar, {"dem_method": Greedy()}),
):
    try:
        run(scenario, parts=CustomParts(**given))
        print("nothing said of", given)
    except RadarError as error:
        print(str(error).replace(chr(10), " "))
"""


@pytest.mark.study
def test_a_wrong_part_is_refused_by_its_name():
    done = subprocess.run([sys.executable, "-c", WRONG], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    expected = [
        "scan = Half is not a valid Scan: it lacks incidence_rad, spacing_m",
        "dem_method is the class Smooth, not an instance; give Smooth(...)",
        "antenna = Empty is not a valid Antenna",
        "range_estimator = int is not a valid RangeEstimator: it lacks __call__",
        "engine = Empty is not a valid Engine: it lacks trace",
        "sensor = NoneType is not a valid Sensor: it lacks observe, correct, record_chirp",
        "terrain = NoneType is not a valid Landscape",
        "materials.ground: sigma0 at 0, 30 and 60 deg is [nan nan nan]; return a finite ratio",
        "materials.nope: no material of the scenario has this name; give one of building, ground",
        "DEM method 'NoMap': return a `Raster` on the grid that is given",
        "range estimator function: return `Ranges` with a finite range for each of the echoes",
        "dem.method: 'Greedy' needs range profiles, which this sensor does not have",
    ]
    said = done.stdout.splitlines()
    assert len(said) == len(expected)
    for line, words in zip(said, expected, strict=True):
        assert words in line


def test_an_engine_gets_what_it_needs_and_not_the_survey():
    prepared = prepare(load_scenario("hills", SHORT))
    names = {field.name for field in dataclasses.fields(prepared.engine_inputs())}
    assert names == {"tracing", "scene", "antenna", "chirp", "seed", "caster", "region_m", "looks", "beams"}
    assert "prepared" not in {field.name for field in dataclasses.fields(prepared.sensor_inputs())}
