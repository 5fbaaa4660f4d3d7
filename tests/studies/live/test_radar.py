"""A stepped radar: bit for bit what a survey hears, and words for poses that it cannot be at."""

import gc
import re

import numpy as np
import pytest
from numba.core import event

from sionna_radar.flight.navigation import DRAWN_AT_ONCE, EndlessGaussMarkov, GaussMarkov
from sionna_radar.foundation.errors import PoseError
from sionna_radar.scenario import load_scenario
from sionna_radar.studies.live.flight import planned_frames
from sionna_radar.studies.live.poses import Poses
from sionna_radar.studies.live.radar import WARM_PULSES, Radar
from sionna_radar.survey.chain import run

pytestmark = pytest.mark.usefixtures("rough_errors", "sketched_rain")

SHORT = {"platform.length_m": 3.0, "tracing.paths_per_pulse": 64}
FLAT = (0.0, 0.0, np.pi / 2)
ELECTRONIC = {"mode": "electronic", "beams": 5, "half_swath_deg": 40.0, "scans_per_s": 8.0, "incidence_deg": 30.0}
NAVIGATION = {
    "platform.navigation.lever_arm_m": [0.5, 0.1, 0.3],
    "platform.navigation.position_markov_m": [0.1, 0.1, 0.1],
    "platform.navigation.attitude_white_deg": [0.1, 0.1, 0.1],
}


def points(frames):
    return tuple(
        np.concatenate([getattr(frame.points, column) for frame in frames])
        for column in ("pulse", "position_m", "range_m", "range_sigma_m", "power")
    )


def without_beside(notice):
    """Return a notice without that of pulses which look beside the footprints of a short planned flight."""
    return re.sub(r" ?\d+ of \d+ pulses look beside the footprints.*", "", notice)


def same_points(frames, survey):
    for column, of_survey in zip(points(frames), points([survey]), strict=True):
        np.testing.assert_array_equal(column, of_survey)


@pytest.mark.parametrize("at_once", [1, 7, 100])
def test_any_grouping_of_poses_gives_the_points_of_a_survey(hills, step_along, at_once):
    radar = Radar(hills.prepared)
    frames = step_along(radar, hills.prepared.flight.time_s, at_once)
    assert len(frames) == -(-hills.pulses // at_once) + 1
    same_points(frames, hills)


@pytest.mark.parametrize(
    ("name", "keys"),
    [
        ("rain", {}),
        ("buildings", {}),
        ("slar", {"platform.length_m": 1.0}),
        ("hills", NAVIGATION),
        ("hills", {"radar.stagger": 0.5}),
        ("hills", {"radar.sweep": "triangular"}),
        ("hills", {"tracing.engine": "gamma", "terrain.spacing_m": 3.0}),
        ("hills", {"tracing.speckle": "per_pulse"}),
        ("hills", {"processing.leakage": "subtract"}),
        ("hills", {"sensor": "lidar"}),
        ("hills", {"processing.ranging": "tracker", "radar.scan.mode": "fixed", "radar.scan.incidence_deg": 0.0}),
        ("hills", {"radar.scan": ELECTRONIC, "radar.antenna": {"kind": "array", "elements": [16, 16]}}),
    ],
)
def test_every_kind_of_radar_hears_what_its_survey_hears(step_along, name, keys):
    survey = run(load_scenario(name, SHORT | keys))
    frames = step_along(Radar(survey.prepared), survey.prepared.flight.time_s, 10)
    same_points(frames, survey)
    waited = [frame.waiting for frame in frames]
    assert (max(waited) > 0) == (name == "rain")
    assert waited[-1] == 0


def test_averaged_chirps_lie_at_interpolated_poses(step_along):
    survey = run(load_scenario("hills", SHORT | {"processing.average.chirps": 2}))
    prepared = survey.prepared
    chirps_s = prepared.bursts.chirps_of(prepared.flight.pulses(np.arange(len(prepared)))).time_s
    frames = step_along(Radar(prepared), np.concatenate([[0.0], chirps_s, chirps_s[-1:] + 1e-6]), 3)
    np.testing.assert_allclose(points(frames)[1], survey.points.position_m, atol=1e-9)


def test_a_straight_flight_needs_poses_at_its_ends_alone(hills, step_along):
    end_s = hills.prepared.flight.time_s[-1]
    frames = step_along(Radar(hills.prepared, max_gap_s=end_s + 1), np.array([0.0, end_s]), 2)
    np.testing.assert_allclose(points(frames)[1], hills.points.position_m, atol=1e-6)


def test_a_frame_is_named_arrays(hills, step_along):
    radar = Radar(hills.prepared)
    frame = step_along(radar, hills.prepared.flight.time_s, 100)[0]
    assert len(frame) == len(frame.readings_m) == frame.spectra.power.shape[0] == frame.beats[0].shape[0]
    assert frame.spectra.power.shape[1] == len(frame.range_m)
    np.testing.assert_array_equal(frame.readings_m[frame.pulses.row_of(frame.echoes.pulse)], frame.echoes.range_m)
    strongest = frame.range_m[np.argmax(frame.spectra.power, axis=1)]
    assert np.median(np.abs(strongest - frame.observation.echoes.range_m)) < 0.5
    # The truth is there, and apart.
    assert np.median(np.linalg.norm(frame.observation.paths.hit_m - frame.pulses.true.position_m[0], axis=1)) < 100.0


def step(radar, time_s, **changed):
    where = {"position_m": (10.0 * time_s - 100.0, 0.0, 60.0), "attitude": FLAT, "velocity_mps": (10.0, 0.0, 0.0)}
    return radar.step(time_s, **(where | changed))


def test_the_first_pose_begins_and_a_gap_begins_anew(hills):
    radar = Radar(hills.prepared, max_gap_s=0.3)
    assert len(step(radar, 1.0)) <= 1
    heard = [step(radar, 1.0 + 0.25 * number) for number in range(1, 4)]
    after = step(radar, 2.5)
    again = [step(radar, 2.5 + 0.25 * number) for number in range(1, 4)]
    assert len(after) <= 1
    assert after.notice == "0.75 s without a pose, more than 0.3 s: nothing was transmitted until 2.5 s."
    before_s, after_s = (np.concatenate([frame.pulses.time_s for frame in frames]) for frames in (heard, again))
    assert before_s[-1] <= 1.75
    assert after_s[0] >= 2.5
    assert [without_beside(frame.notice) for frame in again] == [""] * 3
    # Numbers, the keys of all random values, go on.
    numbers = np.concatenate([frame.pulses.index for frame in (*heard, after, *again)])
    np.testing.assert_array_equal(np.diff(numbers), 1)


@pytest.mark.parametrize(
    ("position_m", "said"),
    [
        ((0.0, 0.0, -30.0), r"The vehicle is [\d.]+ m below the terrain at x = 0.0 m, y = 0.0 m\. Nothing was"),
        ((9e3, 0.0, 60.0), r"There is no terrain under x = 9000.0 m, y = 0.0 m\. Nothing was transmitted\."),
    ],
)
def test_a_pose_that_cannot_be_is_an_empty_frame_that_says_why(hills, position_m, said):
    radar = Radar(hills.prepared)
    step(radar, 0.0)
    frame = step(radar, 0.2, position_m=position_m)
    assert len(frame) == len(frame.points) == 0
    assert frame.spectra is None
    assert frame.beats == ()
    np.testing.assert_array_equal(frame.readings_m, [])
    assert re.match(said, frame.notice)
    assert len(step(radar, 0.4, position_m=(0.0, 0.0, 60.0))) >= 0


def test_nothing_is_interpolated_from_under_the_ground(hills):
    radar = Radar(hills.prepared)
    step(radar, 0.0, position_m=(-100.0, 0.0, -30.0))
    frames = [step(radar, 0.4 * number) for number in range(1, 4)]
    assert len(frames[0]) <= 1
    assert sum(map(len, frames)) > 50
    for frame in frames:
        np.testing.assert_allclose(frame.pulses.true.position_m[:, 2], 60.0, atol=1e-9)


@pytest.mark.usefixtures("unchecked")
def test_measured_poses_that_stop_are_told_of(hills):
    radar = Radar(hills.prepared)
    step(radar, 0.0, measured=Poses.of(0.0, (-100.0, 0.0, 60.0), FLAT, (10.0, 0.0, 0.0)))
    late = Poses.of(0.1, (-99.0, 0.0, 60.0), FLAT, (10.0, 0.0, 0.0))
    assert step(radar, 0.4, measured=late).notice == ""
    late = Poses.of(0.2, (-98.0, 0.0, 60.0), FLAT, (10.0, 0.0, 0.0))
    assert "The measured poses end 0.6 s before this step" in step(radar, 0.8, measured=late).notice
    with pytest.raises(PoseError, match="measured: is a tuple"):
        step(radar, 0.9, measured=(0.9, 0.0, 0.0))


def test_pulses_beyond_the_loaded_ground_are_counted(hills):
    """Ground is loaded within the range of the planned flight: 63 m east of the origin there is none."""
    radar = Radar(hills.prepared)
    frames = [step(radar, 0.2 * number, position_m=(20.0 + 2.0 * number, 0.0, 60.0)) for number in range(6)]
    area = "x = -253 to 63 m, y = -153 to 153 m, the range of the planned flight; plan it wider."
    silent = [len(frame) - len(np.unique(frame.echoes.pulse)) for frame in frames]
    assert max(silent) > 2
    for frame, number in zip(frames, silent, strict=True):
        said = f"{number} of {len(frame)} pulses look beyond {area}" if number else ""
        assert without_beside(frame.notice) == said


@pytest.mark.parametrize(
    ("time_s", "changed", "said"),
    [
        (0.0, {}, "0 s is not after 0.2 s"),
        (0.2, {}, "not after"),
        (0.3, {"position_m": (np.nan, 0.0, 0.0)}, "position_m: must be finite, not nan"),
        (0.3, {"attitude": (0.0, 0.0)}, "attitude"),
    ],
)
def test_impossible_steps_are_refused_and_change_nothing(hills, time_s, changed, said):
    one, other = Radar(hills.prepared), Radar(hills.prepared)
    for radar in (one, other):
        step(radar, 0.0)
        step(radar, 0.2)
    with pytest.raises(PoseError, match=said):
        step(one, time_s, **changed)
    np.testing.assert_array_equal(step(one, 0.4).points.position_m, step(other, 0.4).points.position_m)


def test_times_before_the_flight_are_refused(hills):
    with pytest.raises(PoseError, match="-1 s is before the flight"):
        step(Radar(hills.prepared), -1.0)


def test_points_lie_where_the_navigation_says(hills):
    """Reported a metre higher and half a metre to the north, over the same ground."""
    true, reported = Radar(hills.prepared), Radar(hills.prepared)
    for time_s in (0.0, 0.3):
        where = (10.0 * time_s - 100.0, 0.0, 60.0)
        one = step(true, time_s)
        measured = Poses.of(time_s, np.add(where, (0.0, 0.5, 1.0)), FLAT, (10.0, 0.0, 0.0))
        other = step(reported, time_s, measured=measured)
    assert len(one) > 10
    np.testing.assert_array_equal(one.echoes.range_m, other.echoes.range_m)
    np.testing.assert_allclose(
        other.points.position_m - one.points.position_m, [[0.0, 0.5, 1.0]] * len(one.points), atol=1e-9
    )
    np.testing.assert_array_equal(one.pulses.true.position_m, other.pulses.true.position_m)


def test_nothing_is_compiled_after_it_is_warm(hills):
    radar = Radar(hills.prepared)
    radar.warm_up()
    assert len(gc.get_objects()) < 5_000  # a full collection has next to nothing to look through
    with event.install_recorder("numba:compile") as compiled:
        for number in range(30):
            step(radar, 0.05 * number)
    assert compiled.buffer == []


def test_steps_of_any_size_call_the_kernels_that_are_there(hills):
    import drjit as dr  # only after its library was chosen

    radar = Radar(hills.prepared)

    def kernels(counts):
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            for count in counts:
                radar.sensor.tracer.trace(hills.prepared.flight.sample(count))
            return {kernel["hash"] for kernel in dr.kernel_history() if kernel["type"] == dr.KernelType.JIT}

    warm, later = (radar.sensor._thread.submit(kernels, counts).result() for counts in (WARM_PULSES, (3, 5, 31, 80)))
    assert later
    assert later <= warm


def test_errors_of_the_navigation_go_on_without_an_end_in_bounded_memory():
    kwargs = {"start_s": 0.0, "step_s": 0.01, "correlation_s": 3.0, "seed": 4, "channel": 1}
    known = GaussMarkov(count=20 * DRAWN_AT_ONCE, **kwargs)
    endless = EndlessGaussMarkov(count=2**62, **kwargs)
    for start_s in np.arange(0.0, 19 * DRAWN_AT_ONCE * 0.01, 0.7 * DRAWN_AT_ONCE * 0.01):
        time_s = start_s + np.linspace(0.0, 5.0, 40)
        np.testing.assert_array_equal(endless.at(time_s), known.at(time_s))
        assert len(endless._held[0]) <= 3


FIXED = {
    "terrain": {"kind": "flat", "size_m": [600.0, 600.0]},
    "radar.scan": {"mode": "fixed", "incidence_deg": 45.0},
    "radar.snr_db": 40.0,
}


def flown_beside(beside_m, **keys):
    """Return the readings of two seconds beside the planned path, and the notices of their frames."""
    radar = Radar(load_scenario("hills", FIXED | keys))
    readings_m, notices = [], []
    for step in range(40):
        place_m = (-90.0 + 0.5 * step, beside_m, 50.0)
        frame = radar.step(1.0 + step / 20, place_m, (0.0, 0.0, np.pi / 2), (10.0, 0.0, 0.0))
        readings_m.append(frame.readings_m)
        notices.append(frame.notice)
    return np.concatenate(readings_m), [notice for notice in notices if notice]


def test_a_beam_beside_the_planned_footprints_is_told():
    """Over level ground ranges scatter alike everywhere; where no scatterers were drawn, three times as much."""
    planned_m, silent = flown_beside(0.0)
    beside_m, told = flown_beside(20.0)
    assert silent == []
    assert len(told) == 39
    assert all("pulses look beside the footprints of the planned flight" in notice for notice in told)
    assert beside_m.std() > 2 * planned_m.std()
    drawn_m, silent = flown_beside(20.0, **{"tracing.speckle": "per_pulse"})
    assert silent == []
    assert drawn_m.std() == pytest.approx(planned_m.std(), rel=0.15)


@pytest.mark.parametrize("scenario", ["hills", "buildings", "ridges"])
@pytest.mark.parametrize("mode", ["whisk_broom", "conical"])
def test_the_planned_flight_looks_beside_nothing(scenario, mode):
    keys = {"platform.length_m": 20.0, "radar.scan.mode": mode, "tracing.paths_per_pulse": 64}
    radar = Radar(load_scenario(scenario, keys))
    assert not any("beside the footprints" in frame.notice for frame in planned_frames(radar))
