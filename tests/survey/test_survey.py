"""The whole chain: what it must not depend on, what it must refuse, and how good its DEM is."""

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.constants import Boltzmann

from beams import make_antenna, plane_power
from sionna_radar import load_scenario, run
from sionna_radar.execution.execution import Execution
from sionna_radar.flight.pulses import Pose, PulseSchedule
from sionna_radar.flight.scan import RotatingScan
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.mapping.points import locate
from sionna_radar.survey.custom_parts import CustomParts
from sionna_radar.survey.preparation import prepare
from surveys import hills

pytestmark = pytest.mark.usefixtures("rough_errors")


@pytest.fixture(scope="module")
def survey():
    return run(hills())


@pytest.mark.parametrize("block_size", [1, 64, 10**6])
def test_the_block_size_changes_no_bit(survey, block_size):
    other = run(hills(), execution=Execution(block_size=block_size))
    assert other.points.sha256() == survey.points.sha256()
    np.testing.assert_array_equal(other.dem.height_m, survey.dem.height_m)
    assert other.dem_error == survey.dem_error
    assert (other.pulses, other.paths) == (survey.pulses, survey.paths)


@pytest.mark.parametrize("method", ["refined", pytest.param("stepped", marks=pytest.mark.study)])
def test_maps_of_whole_echoes_do_not_depend_on_the_block_size_and_follow_the_navigation(method):
    keys = {"dem__method": method, "processing__echoes": "all", "platform__length_m": 4.0, "dem__spacing_m": 2.0}
    one, other = run(hills(**keys)), run(hills(**keys), execution=Execution(block_size=17))
    np.testing.assert_array_equal(other.dem.height_m, one.dem.height_m)
    # A navigation that places the radar half a metre too high lifts the whole map by that.
    lifted = run(hills(**keys, platform__navigation={"position_constant_m": [0.0, 0.0, 0.5]}))
    moved = lifted.dem.height_m - one.dem.height_m
    assert np.nanmedian(moved) == pytest.approx(0.5, abs=0.02)
    assert np.mean(np.abs(moved - 0.5)[np.isfinite(moved)] < 0.1) > 0.9


def test_memory_given_back_before_the_map_changes_nothing(survey, monkeypatch):
    """What the sensor forgets, the chirp on record has it draw again."""
    monkeypatch.setattr("sionna_radar.survey.chain.MANY_ECHOES", 0)
    other = run(hills())
    np.testing.assert_array_equal(other.dem.height_m, survey.dem.height_m)
    np.testing.assert_array_equal(other.chirp.beat, survey.chirp.beat)


def test_a_second_run_is_the_same_and_another_seed_is_not(survey):
    assert run(hills()).points.sha256() == survey.points.sha256()
    assert run(hills(seed=5)).points.sha256() != survey.points.sha256()


@pytest.mark.parametrize("keys", [{"radar__sampling": "iq"}, {"radar__antenna": {"beamwidth_deg": [2.0, 4.0]}}])
def test_block_sizes_of_other_radars(keys):
    digests = {
        run(hills(platform__length_m=5.0, **keys), execution=Execution(block_size=size)).points.sha256()
        for size in (1, 37, 999)
    }
    assert len(digests) == 1


def test_the_survey_is_told_whole(survey):
    assert survey.pulses == len(survey.schedule) == 4 * 50  # 4 turns of 50 pulses in 100 deg
    # Scatterers lie as densely as the smallest footprint asks for, in powers of two.
    assert 0.7 * 128 < survey.paths / survey.pulses < 1.5 * 128
    assert 0.9 * survey.pulses <= len(survey.points) <= survey.pulses
    assert np.all(np.diff(survey.points.pulse) > 0)
    assert survey.dem.grid == survey.truth.grid == survey.error.grid
    assert {"prepare", "trace", "synthesise", "detect", "map", "total"} <= set(survey.timing_s)
    assert survey.scenario == hills()


def test_progress_tells_every_stage_and_counts_every_pulse():
    calls = []
    run(
        hills(platform__length_m=5.0),
        execution=Execution(block_size=20, progress=lambda *step: calls.append(step)),
    )
    assert calls == [
        *(("preparing", done, 6) for done in range(7)),
        ("tracing", 0, 50),
        ("tracing", 25, 50),  # blocks hold whole turns of the antenna
        ("tracing", 50, 50),
        ("mapping", 0, 0),
        ("mapping", 1, 1),
    ]


def test_points_lie_near_the_ground(survey):
    ground = prepare(hills()).world.ground_m(survey.points.position_m[:, :2])
    off = survey.points.position_m[:, 2] - ground
    assert np.median(np.abs(off)) < 0.5
    assert survey.dem_error.count > 500
    assert survey.dem_error.rms_m < 0.5  # the paper: 0.29 m with four times the paths
    np.testing.assert_allclose(survey.error.height_m, survey.dem.height_m - survey.truth.height_m)


def test_on_a_plane_the_dem_is_flat():
    keys = {"terrain": {"kind": "flat", "size_m": [400.0, 400.0]}, "tracing__paths_per_pulse": 512}
    error = run(hills(**keys, platform__length_m=40.0)).dem_error
    assert abs(error.mean_m) < 0.1
    assert error.rms_m < 0.3
    assert error.coverage > 0.7


def test_the_chirp_on_record_is_the_one_in_the_middle(survey):
    chirp = survey.chirp
    assert chirp.pulse == survey.pulses // 2
    assert len(chirp.beat) == len(chirp.sample_time_s) == 1024
    assert len(chirp.power) == len(chirp.range_m) == len(chirp.threshold)
    assert len(chirp.echo_range_m) == 1
    # The echo on the axis of the spectrum, corrected for Doppler, is the point of that pulse.
    pose = survey.schedule.pulses(np.array([chirp.pulse])).true
    shift = 2 * 77e9 * pose.boresight_range_rate_mps[0] / (2 * 500e6 * 360)
    mine = survey.points.range_m[survey.points.pulse == chirp.pulse]
    assert chirp.echo_range_m[0] - shift == pytest.approx(mine[0], abs=1e-9)


def spoilt(pose: Pose) -> Pose:
    return Pose(**{field.name: np.full_like(getattr(pose, field.name), np.nan) for field in fields(Pose)})


def test_the_truth_is_not_the_estimate():
    """After the echoes are received, nothing may look at where the radar really was."""
    ready = prepare(hills(platform__length_m=5.0))
    pulses = ready.flight.pulses(np.arange(len(ready.flight)))
    beat = ready.receiver.beat(ready.sensor_inputs().tracer().trace(pulses), pulses)
    points = []
    for seen in (pulses, replace(pulses, true=spoilt(pulses.true))):
        echoes = ready.instrument.detector.detect(beat, seen.index, seen.measured)
        points.append(locate(echoes, seen.index, seen.measured))
    assert points[0].sha256() == points[1].sha256()
    # The synthesis, too, knows the flight through the paths alone.
    paths = ready.sensor_inputs().tracer().trace(pulses)
    again = ready.receiver.beat(paths, replace(pulses, true=spoilt(pulses.true), measured=spoilt(pulses.measured)))
    np.testing.assert_array_equal(again, beat)


def test_run_locates_from_the_measured_pose(monkeypatch):
    """Navigation that errs by a constant shifts every point of `run` by it, and by the Doppler of its velocity."""
    scenario = hills(platform__length_m=5.0)
    right = run(scenario).points
    error_m, error_mps = np.array([3.0, -2.0, 1.0]), np.array([0.4, 0.0, 0.2])
    exact = PulseSchedule.pulses

    def erring(self, index):
        pulses = exact(self, index)
        pose = pulses.measured
        wrong = replace(pose, position_m=pose.position_m + error_m, velocity_mps=pose.velocity_mps + error_mps)
        return replace(pulses, measured=wrong)

    monkeypatch.setattr(PulseSchedule, "pulses", erring)
    moved = run(scenario).points
    np.testing.assert_array_equal(moved.pulse, right.pulse)
    along = (right.position_m - right.origin_m) / right.range_m[:, None]
    # A velocity wrong by v changes the range rate by -v along the beam, and 1 m/s of it reads 0.428 m of range.
    metres = 2 * 77e9 / (2 * 500e6 * 360) * (along @ error_mps)
    np.testing.assert_allclose(moved.range_m - right.range_m, metres, atol=1e-9)
    np.testing.assert_allclose(moved.position_m - right.position_m, error_m + metres[:, None] * along, atol=1e-9)


def test_a_scan_and_an_antenna_of_ones_own():
    down = RotatingScan(
        mode="fixed", incidence_rad=0.0, half_swath_rad=np.pi, rotation_rad_s=0.0, start_rad=0.0, stabilised=True
    )
    survey = run(hills(platform__length_m=3.0), parts=CustomParts(antenna=make_antenna(1.0, 1.0), scan=down))
    assert survey.pulses == 108  # 0.3 s of 360 chirps a second
    assert survey.replaced == {
        "radar.antenna": "sionna_radar.radar.antenna.Antenna, half-power beam 1 x 1 deg",
        "radar.scan": "sionna_radar.flight.scan.RotatingScan",
    }
    np.testing.assert_allclose(survey.points.position_m[:, 1], 0.0, atol=1e-9)
    top = survey.points.position_m[:, 2] + survey.points.range_m
    np.testing.assert_allclose(top, survey.schedule.pulses(np.arange(1)).true.position_m[0, 2], atol=1e-9)


def test_a_survey_is_a_few_lines_in_print(survey):
    assert len(repr(survey)) < 400
    assert f"{survey.lit_error.rms_m:.3f} m" in repr(survey)
    assert survey.replaced == {}
    assert survey.warnings == ()


def test_rain_before_near_ground_asks_for_finer_cells():
    """A wide beam over few cells of rain before the ground: a lower flight leaves it as it is."""
    low = {"platform.length_m": 4.0, "platform.altitude_m": 12.0, "weather.rain_rate_mm_per_h": 6.0}
    low["radar.antenna.beamwidth_deg"] = 10.0
    coarse, fine = (run(load_scenario("hills", {**low, "radar.bandwidth_hz": width_hz})) for width_hz in (150e6, 600e6))
    (warning,) = (text for text in coarse.warnings if "come from the rain" in text)
    assert "raise radar.bandwidth_hz, or fly higher" in warning
    assert "fly lower" not in warning
    assert not any("come from the rain" in text for text in fine.warnings)


def test_rain_in_front_of_the_ground_makes_a_warning():
    off = {"volume_clutter": "off"}
    raining = run(hills(platform__length_m=5.0, weather={"rain_rate_mm_per_h": 20.0}, processing=off))
    assert "most echoes (50 of 50) come from the rain in front" in raining.warnings[0]
    assert raining.warnings[0].endswith("set processing.volume_clutter = 'auto'")
    strict = {"cfar": {"false_alarm_probability": 1e-12}}
    weak = run(hills(platform__length_m=5.0, radar__snr_db=-60.0, processing=strict))
    assert len(weak.points) == 0
    assert "no echo was detected" in weak.warnings[0]
    assert "raise radar.snr_db" in weak.warnings[0]


def test_echoes_below_a_step_of_the_converter_ask_for_gain():
    """A converter that a sine of the power P fills has steps whose rounding has the power P / (1.5 * 4^bits)."""
    converter = {"bits": 10, "full_scale_dbm": 10.0, "gain_db": 30.0}
    keys = {"snr_db": None, "transmit_power_dbm": 10.0, "noise_figure_db": 12.0}
    keys = {f"radar.{key}": value for key, value in keys.items()} | {"radar.receiver.converter": converter}
    lost = run(hills(platform__length_m=5.0, **keys))
    assert len(lost.points) == 0
    sampled_hz = 1024 * 360.0 / 2
    noise_dbm = 30 + 10 * np.log10(Boltzmann * 290.0 * sampled_hz) + 12.0
    over_db = 10.0 - 30.0 - 20 * np.log10(2**10) - 10 * np.log10(1.5) - noise_dbm
    assert f"raise radar.receiver.converter.gain_db (its rounding lies {over_db:.0f} dB" in lost.warnings[0]


FLAT = {"kind": "flat", "size_m": [300.0, 300.0]}


@pytest.mark.parametrize(
    ("keys", "field", "said"),
    [
        # 1 m over the ground at the start, level, into hills 8 m high.
        ({"platform__altitude_m": 1.0, "platform__length_m": 120.0}, "platform.altitude_m", "under the surface"),
        (
            {"terrain": FLAT, "buildings": [{"position_m": [0.0, 0.0], "size_m": [20.0, 20.0, 60.0]}]},
            "platform.altitude_m",
            "under the surface",
        ),
        ({"terrain": {"kind": "flat", "size_m": [80.0, 80.0]}}, "radar.scan", "leave the terrain"),
        # The beams meet the ground 60 m away, farther than its corners.
        (
            {"terrain": {"kind": "flat", "size_m": [80.0, 80.0]}, "platform__altitude_m": 60.0}
            | {"platform__start_m": [0.0, 0.0], "platform__length_m": 2.0},
            "radar.scan",
            "100 % of the beams leave the terrain",
        ),
        ({"platform__length_m": 400.0}, "platform.start_m", "no ground under it"),
        ({"platform__start_m": [1000.0, 0.0]}, "platform.start_m", "no ground under it"),
        ({"platform__length_m": 0.01}, "radar.scan", "no pulse falls into the sector"),
        ({"radar__scan": {"half_swath_deg": 0.5}}, "radar.scan", "no pulse falls into the sector"),
        ({"platform__altitude_m": 120.0}, "radar.samples_per_chirp", "beyond the 153.5 m"),
        (
            {"radar__samples_per_chirp": 256, "processing__cfar": {"guard": 10}},
            "radar.samples_per_chirp",
            "beyond the 38.4 m",
        ),
        (
            {"radar__scan": {"mode": "fixed", "incidence_deg": 80.0}, "terrain": FLAT | {"size_m": [2000.0, 2000.0]}},
            "radar.samples_per_chirp",
            "beyond the 153.5 m",
        ),
        ({"dem__spacing_m": 0.001}, "dem.spacing_m", "more than 25,000,000; raise it to"),
        ({"processing__cfar": {"guard": 0}}, "processing.cfar.guard", "needs at least 2"),
    ],
)
def test_what_cannot_be_flown_is_refused(keys, field, said):
    with pytest.raises(ScenarioError) as caught:
        prepare(hills(**keys))
    found = {problem.field: problem.message for problem in caught.value.problems}
    assert field in found, found
    assert said in found[field]


def test_iq_sampling_reaches_twice_as_far():
    keys = {"platform__altitude_m": 120.0, "terrain": {"kind": "flat", "size_m": [900.0, 900.0]}}
    prepare(hills(radar__sampling="iq", **keys))
    with pytest.raises(ScenarioError):
        prepare(hills(radar__sampling="real", **keys))


def test_the_reference_echo_sets_the_noise():
    ready = prepare(hills(terrain={"kind": "flat", "size_m": [400.0, 400.0]}))
    echo = plane_power(ready.instrument.antenna, 50.0, 45.0, gamma=1.32e-3)
    assert 10 * np.log10(echo / ready.receiver.noise_power_w) == pytest.approx(30.0, abs=0.02)


def test_the_received_level_is_that_of_the_transmitter():
    """10 dBm over a plane: the mean power of the beat is the radar equation's, and the noise k T F B."""
    radar = {"transmit_power_dbm": 10.0, "noise_figure_db": 15.0, "scan": {"mode": "fixed", "incidence_deg": 45.0}}
    keys = {"terrain": {"kind": "flat", "size_m": [600.0, 600.0]}, "platform__length_m": 30.0}
    ready = prepare(hills(radar=radar, **keys))
    pulses = ready.flight.pulses(np.arange(len(ready.flight)))
    beat = ready.receiver.beat(ready.sensor_inputs().tracer().trace(pulses), pulses)
    echo = 0.01 * plane_power(ready.instrument.antenna, 50.0, 45.0, gamma=1.32e-3)
    noise = 10 ** ((-173.975 + 15 - 30) / 10) * 1024 * 360 / 2
    # Speckle: 1080 pulses of fluctuating power leave 3 %.
    assert np.mean(beat**2) == pytest.approx(echo + noise, rel=0.12)
