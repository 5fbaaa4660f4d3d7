"""The sensors behind one seam, what each knows of the flight, and a survey mapped again."""

import gc
import weakref
from dataclasses import fields, replace

import numpy as np
import pytest

from sionna_radar import run
from sionna_radar.detection.echoes import Echoes
from sionna_radar.execution.execution import Execution
from sionna_radar.flight.pulses import Pose
from sionna_radar.report.files.contents import Figures
from sionna_radar.report.survey.products import write_survey
from sionna_radar.scenario.platform import NavigationTable
from sionna_radar.survey.custom_parts import CustomParts
from sionna_radar.survey.observation import observe
from sionna_radar.survey.observed_survey import observe_survey
from sionna_radar.survey.placement import place
from sionna_radar.survey.preparation import prepare
from sionna_radar.survey.sensors.lidar import Lidar
from sionna_radar.survey.sensors.radar import Radar
from sionna_radar.survey.sensors.sensor import Observation, Sensor
from sionna_radar.tracing.paths import trace_boresights
from surveys import hills

pytestmark = pytest.mark.usefixtures("rough_errors")

NOISY = {"position_markov_m": 0.3, "velocity_white_mps": 0.2, "attitude_markov_deg": 0.2, "time_offset_s": 0.02}


@pytest.fixture(scope="module")
def exact():
    return run(hills())


@pytest.fixture(scope="module")
def lidar():
    return run(hills(sensor="lidar"))


@pytest.mark.parametrize(
    ("keys", "kind"),
    [({}, Radar), ({"radar.sweep": "triangular"}, Radar), ({"sensor": "lidar"}, Lidar)],
)
def test_a_sensor_sees_the_truth_and_corrects_by_the_measured_pose(keys, kind):
    """Tracing reads the true pose alone; after it, nothing may."""
    ready = prepare(hills(**keys, platform__navigation=NOISY))
    sensor = ready.build_sensor()
    assert isinstance(sensor, kind)
    assert isinstance(sensor, Sensor)
    pulses = ready.flight.pulses(np.arange(20))
    spoilt = Pose(**{f.name: np.full_like(getattr(pulses.true, f.name), np.nan) for f in fields(Pose)})
    seen = sensor.observe(pulses).echoes
    blind = sensor.observe(replace(pulses, measured=spoilt)).echoes
    np.testing.assert_array_equal(seen.range_m, blind.range_m)
    # The exact and the erring navigation record the same.
    other = prepare(hills(**keys))
    elsewhere = other.build_sensor().observe(other.flight.pulses(np.arange(20))).echoes
    np.testing.assert_array_equal(elsewhere.range_m, seen.range_m)


def test_placing_reads_the_measured_pose_alone(monkeypatch):
    ready = prepare(hills(platform__navigation=NOISY))
    sensor, observed = observe(ready, Execution())
    echoes = observed.echoes
    points = place(echoes, sensor, ready.flight)
    made = type(ready.flight).pulses

    def without_truth(schedule, index):
        pulses = made(schedule, index)
        bad = Pose(**{f.name: np.full_like(getattr(pulses.true, f.name), np.nan) for f in fields(Pose)})
        return replace(pulses, true=bad)

    monkeypatch.setattr(type(ready.flight), "pulses", without_truth)
    assert place(echoes, sensor, ready.flight).sha256() == points.sha256()


def test_errors_of_navigation_spoil_the_dem_but_not_the_echoes(exact):
    erring = run(hills(platform__navigation=NOISY))
    np.testing.assert_array_equal(erring.points.pulse, exact.points.pulse)
    np.testing.assert_array_equal(erring.points.power, exact.points.power)
    assert erring.paths == exact.paths
    assert erring.dem_error.rms_m > 1.1 * exact.dem_error.rms_m
    again = run(hills(platform__navigation=NOISY), execution=Execution(block_size=13))
    assert again.points.sha256() == erring.points.sha256()


def test_a_survey_mapped_again_is_the_survey_flown_with_those_errors(exact):
    survey = observe_survey(hills())
    assert survey.points(None).sha256() == exact.points.sha256()
    assert survey.lit_error(None) == exact.lit_error
    navigation = survey.navigation(NavigationTable(**NOISY))
    assert survey.lit_error(navigation) == run(hills(platform__navigation=NOISY)).lit_error
    assert survey.lit_error(survey.navigation(NavigationTable(**NOISY), seed=9)) != survey.lit_error(navigation)


def test_a_survey_is_mapped_again_by_the_scenarios_own_method():
    """Each navigation moves the whole echoes that the map models, as it would have in flight."""
    keys = {"platform.length_m": 6.0, "dem.method": "smooth", "tracing.paths_per_pulse": 64}
    survey = observe_survey(hills(**keys))
    assert survey.lit_error(None) == run(hills(**keys)).lit_error
    erring = run(hills(**keys, platform__navigation=NOISY))
    assert survey.lit_error(survey.navigation(NavigationTable(**NOISY))) == erring.lit_error


def test_a_velocity_error_of_5_cm_a_second_is_2_cm_of_range():
    down = {"radar.scan": {"mode": "fixed", "incidence_deg": 0.0}}
    survey = observe_survey(hills(**down))
    wrong = survey.navigation(NavigationTable(velocity_constant_mps=(0.0, 0.0, 0.05)))
    off = survey.points(wrong).range_m - survey.points(None).range_m
    np.testing.assert_allclose(off, -0.0214, atol=1e-4)  # a climb believed in is a receding ground corrected for


def test_a_lidar_says_what_it_looks_through():
    stand = {"polygon_m": [[-50, -50], [50, -50], [50, 50]], "height_m": 3.0, "extinction_db_per_m": 1.0}
    seen = run(hills(sensor="lidar", vegetation=[stand | {"backscatter_db_per_m": -20.0}]))
    assert any(
        "the lidar does not model [[vegetation]] and measures the ground" in warning for warning in seen.warnings
    )


def test_a_lidar_without_an_echo_names_its_own_keys():
    silent = run(hills(sensor="lidar", lidar={"wavelength_nm": 905, "reflectivities": {"ground": 0.0}}))
    assert silent.warnings == (
        "no echo was detected; raise lidar.clear_range_m, lidar.ground_reflectivity or lidar.reflectivities, or fly "
        "lower",
    )


def test_the_lidar_is_exact_and_shows_what_the_beam_costs(exact, lidar):
    ground = prepare(hills()).world.ground_m(lidar.points.position_m[:, :2])
    np.testing.assert_allclose(lidar.points.position_m[:, 2], ground, atol=0.03)  # facets against bilinear heights
    assert len(lidar.points) == lidar.pulses == exact.pulses
    assert lidar.chirp is None
    assert lidar.dem_error.rms_m < 0.3 * exact.dem_error.rms_m


def test_noise_of_the_lidar_is_what_was_asked_for(lidar):
    noisy = run(hills(sensor="lidar", lidar={"range_noise_m": 0.05}))
    off = noisy.points.range_m - lidar.points.range_m
    assert off.std() == pytest.approx(0.05, rel=0.2)
    assert noisy.points.sha256() == run(noisy.scenario, execution=Execution(block_size=11)).points.sha256()


def test_a_lidar_survey_is_written_without_a_chirp(lidar, tmp_path):
    names = {path.name for path in write_survey(lidar, tmp_path / "out", figures=Figures.PNG)}
    assert {"summary.json", "points.laz", "dem.png", "power_map.png"} <= names
    assert "chirp.png" not in names


def test_the_triangle_needs_no_velocity(exact):
    survey = run(hills(radar__sweep="triangular"))
    assert survey.chirp is not None
    assert len(survey.points) > 0.9 * survey.pulses
    assert survey.dem_error.rms_m < 1.3 * exact.dem_error.rms_m
    wrong = {"velocity_constant_mps": (3.0, 0.0, 0.0)}
    untouched = run(hills(radar__sweep="triangular", platform__navigation=wrong))
    assert untouched.points.sha256() == survey.points.sha256()
    assert run(hills(platform__navigation=wrong)).dem_error.rms_m > 1.5 * survey.dem_error.rms_m
    assert run(survey.scenario, execution=Execution(block_size=17)).points.sha256() == survey.points.sha256()


class EveryOther:
    """A sensor of one's own: exact, but blind on every other pulse."""

    def __init__(self, given):
        self.caster = given.engine.caster

    def observe(self, pulses):
        paths = trace_boresights(pulses, self.caster)
        even = np.flatnonzero(paths.pulse % 2 == 0)
        echoes = Echoes(
            pulse=paths.pulse[even],
            number=np.zeros(len(even), dtype=np.int64),
            range_m=paths.delay_s[even] * 299_792_458.0 / 2,
            range_sigma_m=np.zeros(len(even)),
            power=np.ones(len(even)),
            echo_snr_db=np.zeros(len(even)),
        )
        return Observation(paths=paths, echoes=echoes)

    def correct(self, echoes, pulse, measured):
        return echoes

    def record_chirp(self, pulses):
        return None


def test_a_sensor_of_ones_own(lidar):
    survey = run(hills(), parts=CustomParts(sensor=EveryOther))
    mine = lidar.points.pulse % 2 == 0
    np.testing.assert_allclose(survey.points.position_m, lidar.points.position_m[mine])


@pytest.mark.parametrize("sweep", ["up", "triangular"])
def test_chirps_recorded_together_are_those_recorded_one_by_one(sweep):
    keys = {"processing": {"echoes": "strongest"}} if sweep == "triangular" else {}
    prepared = prepare(hills(radar__sweep=sweep, **keys))
    sensor, index = prepared.build_sensor(), np.array([3, 40, 41, 170])
    together = sensor.record_chirps(prepared.flight.pulses(index))
    for pulse, one in zip(index, together, strict=True):
        alone = sensor.record_chirp(prepared.flight.pulses(np.array([pulse])))
        for field in fields(one):
            np.testing.assert_array_equal(getattr(one, field.name), getattr(alone, field.name), field.name)


def test_a_radar_and_its_threads_end_with_its_last_user():
    """Without the collector of cycles: a loop of surveys would keep the threads and scenes of many."""
    prepared = prepare(hills())
    prepared.build_sensor()  # what is compiled on first use holds what it was compiled for
    gc.collect()
    gc.disable()
    try:
        sensor = prepared.build_sensor()
        gone = weakref.ref(sensor)
        del sensor
        assert gone() is None
    finally:
        gc.enable()
