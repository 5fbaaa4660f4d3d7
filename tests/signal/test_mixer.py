"""Mixing with a real oscillator against the direct computation, and against closed forms."""

import numpy as np
import pytest
from scipy.special import jv

from direct_receiver import direct_beat, points_at
from flights import make_pulses
from receivers import radar_with, receiver_of
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.radar.build import build_sweeps
from sionna_radar.scenario import StageParameters, load_scenario
from sionna_radar.scenario.radar import RadarTable
from sionna_radar.signal import stages
from sionna_radar.signal.beat import SampleGrid, synthesise
from sionna_radar.signal.build import StageInputs, build_mixer
from sionna_radar.signal.mixer import STEP_RAD, cubic_weights
from sionna_radar.signal.stages import Received

NOISY = {"phase_noise_dbc_hz": [[1e3, -40.0], [1e5, -50.0], [1e6, -70.0]]}
ERRORS = {
    "quadratic": {"quadratic_hz": 3e5},
    "cubic": {"cubic_hz": -4e5},
    "sinusoidal": {"sinusoidal_hz": 2e5, "sinusoidal_periods": 7.0},
    "settling": {"settling_hz": 1e6, "settling_time_s": 1e-4},
    "noise": NOISY,
    "both": {**NOISY, "cubic_hz": 5e5},
}


def bent(oscillator=None, **keys) -> RadarTable:
    return radar_with({"oscillator": oscillator or {}}, **keys)


def mixed(radar: RadarTable, paths, pulses, *, guard: int = 4, sweep: int = 0):
    sweeps = build_sweeps(radar)
    grid = SampleGrid(sweeps[sweep], 2, guard)
    mixer = build_mixer(StageParameters(stage="mixer"), StageInputs(radar=radar, sweeps=sweeps, high_pass=None))
    held = Received(
        paths=paths,
        pulses=pulses,
        grid=grid,
        sweep=sweep,
        sweeps=len(sweeps),
        transmit_power_w=1.0,
        noise_power_w=0.0,
        seed=5,
    )
    return mixer, grid.wide, mixer(held).samples


def error_of(mixer, wide, pulse: int, sweep: int = 0):
    """The oscillator's phase error at any time: closed forms, and waves summed one by one."""
    oscillator = mixer.oscillator
    waves = None
    if oscillator.noise is not None:
        waves = oscillator.noise.waves(5, np.array([pulse]), wide.samples, wide.sampling_rate_hz, sweep)

    def error(t):
        found = np.zeros(t.shape) if oscillator.error is None else oscillator.error.phase(t)
        if waves is not None:
            turn = np.exp(2j * np.pi * np.outer(t - wide.sample_time_s[0], waves.offset_hz))
            found = found + 2 * (turn @ waves.amplitude[0]).real
        return found

    return error


@pytest.mark.parametrize("kind", ERRORS)
@pytest.mark.parametrize(("sweep", "sampling"), [("up", "iq"), ("down", "iq"), ("up", "real")])
def test_a_continuum_of_echoes_is_mixed_as_directly_computed(kind, sweep, sampling):
    # The waves of random phase are summed one by one: fewer samples and echoes of them.
    samples, count = (128, 8) if kind in ("noise", "both") else (256, 30)
    radar = bent(ERRORS[kind], sweep=sweep, sampling=sampling, samples_per_chirp=samples)
    random = np.random.default_rng(1)
    far = random.uniform(1, (0.25 if sampling == "iq" else 0.12) * samples, count)
    gain = random.normal(size=count) + 1j * random.normal(size=count)
    paths, pulses = points_at(far, gain, 6.0, pulse=3), make_pulses(1, first=3)
    mixer, wide, found = mixed(radar, paths, pulses)
    expected = direct_beat(paths, wide, wide.sample_time_s, error_of(mixer, wide, 3))
    ideal = direct_beat(paths, wide, wide.sample_time_s)
    if sampling == "real":
        expected, ideal = np.sqrt(2) * expected.real, np.sqrt(2) * ideal.real
    changed = np.linalg.norm(expected - ideal)
    assert changed > 0.01 * np.linalg.norm(ideal)
    # Of the whole echo where its sweep is bent, and at most of what is changed where it is not.
    size = STEP_RAD**3 / 12 * changed if kind == "noise" else 3 / 128 * STEP_RAD**4 * np.linalg.norm(ideal)
    assert np.linalg.norm(found[0] - expected) < size + 1e-5 * np.linalg.norm(ideal)


def test_the_shares_of_a_path_are_those_of_cubic_interpolation():
    place = np.linspace(-1, 1, 21)
    nodes = np.arange(-4, 5)
    weights = np.array([cubic_weights(place - node) for node in nodes])
    for power in range(4):
        np.testing.assert_allclose(nodes**power @ weights, place**power, atol=1e-14)


def test_a_sinusoidal_error_has_paired_echoes_that_grow_with_range():
    """J1 over J0 of 2 s T / p sin(pi p tau / T), p periods away from the echo."""
    size_hz, periods = 5e4, 20.0
    radar = bent({"sinusoidal_hz": size_hz, "sinusoidal_periods": periods}, samples_per_chirp=1024)
    receiver = receiver_of(radar)
    chirp = receiver.chirp
    for cell in (60, 120, 360):
        far = cell * chirp.range_resolution_m
        power = np.abs(np.fft.rfft(receiver.beat(points_at(far), make_pulses(1))[0])) ** 2
        depth = 2 * size_hz * chirp.duration_s / periods * np.sin(np.pi * periods * 2 * far / 299_792_458.0 * 360)
        expected = (jv(1, depth) / jv(0, depth)) ** 2
        assert power[cell - 20] / power[cell] == pytest.approx(expected, rel=0.02)
        assert power[cell + 20] / power[cell] == pytest.approx(expected, rel=0.02)


def test_a_quadratic_error_smears_an_echo_in_proportion_to_its_range():
    """The beat moves by 8 q tau / T over the sweep: 8 q / B cells for each cell of range and each of bandwidth."""
    radar = bent({"quadratic_hz": 2e7}, samples_per_chirp=1024)
    chirp = build_sweeps(radar)[0]
    for far in (20.0, 60.0, 120.0):
        _, wide, beat = mixed(radar.model_copy(update={"sampling": "iq"}), points_at(far), make_pulses(1))
        frequency = np.diff(np.unwrap(np.angle(beat[0]))) / (2 * np.pi) * wide.sampling_rate_hz
        # Before the sweep its error stands still, so that the first points see less of it.
        inside = frequency[40:-40]
        moved = (inside[-1] - inside[0]) * 2048 / (len(inside) - 1)
        assert moved == pytest.approx(8 * 2e7 * 2 * far / 299_792_458.0 / chirp.duration_s, rel=0.01)


def test_drift_scales_ranges():
    plain = bent({"drift_ppm_per_k": 25.0, "warmer_k": 40.0})
    receiver, far = receiver_of(plain), np.array([20.0, 30.0, 31.0])
    found = receiver.beat(points_at(far, [1, 2j, 3]), make_pulses(1))
    expected = synthesise(points_at(far * 1.001, [1, 2j, 3]), make_pulses(1), receiver.chirp)
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_a_used_window_is_that_part_of_the_whole_sweep():
    whole, part = bent(sampling="iq"), bent({"used_window": [0.25, 0.75]}, sampling="iq")
    long, short = build_sweeps(whole)[0], build_sweeps(part)[0]
    assert short.samples == 128
    assert short.bandwidth_hz == pytest.approx(long.bandwidth_hz / 2)
    assert short.slope_hz_s == pytest.approx(long.slope_hz_s)
    assert short.sampling_rate_hz == pytest.approx(long.sampling_rate_hz)
    assert short.max_range_m == pytest.approx(long.max_range_m)
    late = build_sweeps(bent({"used_window": [0.5, 1.0]}, sampling="iq"))[0]
    paths = points_at([20.0, 33.0], [1, 1j])
    expected = direct_beat(paths, long, long.sample_time_s)
    for chirp, first in ((short, 64), (late, 128)):
        np.testing.assert_allclose(
            synthesise(paths, make_pulses(1), chirp)[0], expected[first : first + 128], atol=1e-5
        )


def test_an_error_of_the_whole_sweep_is_seen_in_its_used_window():
    error = {"cubic_hz": 4e5, "settling_hz": 1e6, "settling_time_s": 1e-4}
    whole = bent(error, sampling="iq")
    mixer, _, _ = mixed(whole, points_at(30.0), make_pulses(1))
    part = bent({**error, "used_window": [0.5, 1.0]}, sampling="iq")
    own, _, _ = mixed(part, points_at(30.0), make_pulses(1))
    t = np.linspace(-3e-4, 3e-4, 9)
    middle = 64 / build_sweeps(whole)[0].sampling_rate_hz
    np.testing.assert_allclose(own.oscillator.error.frequency_hz(t), mixer.oscillator.error.frequency_hz(t + middle))


def test_a_table_of_errors_is_integrated(tmp_path):
    path = tmp_path / "sweep.csv"
    path.write_text("time_s,error_hz\n0,1e5\n0.001,-2e5\n0.002,3e5\n")
    radar = bent({"sweep_error": path})
    mixer, _, _ = mixed(radar, points_at(30.0), make_pulses(1))
    t = np.linspace(-0.0016, 0.0018, 20001)
    phase = mixer.oscillator.error.phase(t)
    slope = np.gradient(phase, t) / (2 * np.pi)
    np.testing.assert_allclose(slope[2:-2], mixer.oscillator.error.frequency_hz(t)[2:-2], atol=100.0)
    assert mixer.oscillator.error.frequency_hz(np.array([0.0]))[0] == pytest.approx(
        np.interp(1 / 720, [0.001, 0.002], [-2e5, 3e5])
    )
    for text in ("time_s\n0\n", "time_s,error_hz\n0,x\n1,2\n", "time_s,error_hz\n1,1\n0,1\n", ""):
        path.write_text(text)
        with pytest.raises(InputFileError, match=r"radar\.receiver\.oscillator\.sweep_error"):
            receiver_of(radar)


@pytest.mark.parametrize(
    ("text", "used"),
    [
        ("time_s,error_hz\n0,0\n0.001,0\n", {}),
        ("time_s,error_hz\n0,1e5\n0.0001,0\n0.001,0\n", {"used_window": [0.5, 1.0]}),
    ],
)
def test_a_table_without_errors_over_the_samples_bends_nothing(text, used, tmp_path):
    path = tmp_path / "sweep.csv"
    path.write_text(text)
    paths, pulses = points_at(30.0), make_pulses(1)
    _, _, found = mixed(bent({"sweep_error": path, **used}), paths, pulses)
    _, _, straight = mixed(bent(used), paths, pulses)
    np.testing.assert_array_equal(found, straight)


@pytest.mark.parametrize("keys", [{"cubic_hz": 5e-324}, {"quadratic_hz": -1e-310}, {"sinusoidal_hz": 1e-200}])
def test_an_error_lost_in_rounding_bends_nothing(keys):
    paths, pulses = points_at(30.0), make_pulses(1)
    np.testing.assert_array_equal(mixed(bent(keys), paths, pulses)[2], mixed(bent(), paths, pulses)[2])


@pytest.mark.parametrize("kind", ["noise", "both"])
@pytest.mark.parametrize("sweep", ["up", "triangular"])
def test_a_pulse_is_the_same_in_any_block(kind, sweep, monkeypatch):
    receiver = receiver_of(bent(ERRORS[kind], sweep=sweep), noise_w=1e-3)
    random = np.random.default_rng(2)
    paths = points_at(random.uniform(20, 60, 40), 1.0, 3.0, pulse=np.sort(random.integers(0, 8, 40)))
    whole = receiver.beats(paths, make_pulses(8))
    alone = receiver.beats(paths.rows(paths.pulse == 5), make_pulses(1, first=5))
    for a, b in zip(whole, alone, strict=True):
        np.testing.assert_array_equal(a[5], b[0])
    monkeypatch.setattr(stages, "MAX_POINTS", 3 * receiver.chain.grid(receiver.chirp).wide.samples)
    for a, b in zip(whole, receiver.beats(paths, make_pulses(8)), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("keys", [{"cubic_hz": 6e7}, {"phase_noise_dbc_hz": [[1e3, -5.0]]}])
def test_an_oscillator_far_from_its_sweep_is_refused(keys):
    with pytest.raises(ScenarioError, match=r"radar.receiver.oscillator: shifts the frequency by"):
        receiver_of(bent(keys, samples_per_chirp=4096))


def test_an_ideal_receiver_has_no_chain_and_a_chain_of_ideal_stages_changes_nothing():
    assert receiver_of(bent()).chain is None
    plain = receiver_of(bent(sampling="iq", sweep="triangular"), noise_w=0.1)
    radar = radar_with({"stages": {"noise": "noise"}}, sampling="iq", sweep="triangular")
    staged = receiver_of(radar, noise_w=0.1)
    paths = points_at([20.0, 40.0, 41.0], 1.0, 2.0, pulse=[0, 0, 1])
    for a, b in zip(plain.beats(paths, make_pulses(2)), staged.beats(paths, make_pulses(2)), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12)


@pytest.mark.parametrize("sampling", ["real", "iq"])
def test_filters_leave_what_they_pass_and_take_what_they_do_not(sampling):
    """A guarded and faded signal has a settled high-pass, and loses nothing in its band to the ideal filter."""
    keys = {"high_pass_corner_hz": 5e3, "oscillator": {"cubic_hz": 1e-6}}
    receiver = receiver_of(radar_with(keys, samples_per_chirp=1024, sampling=sampling))
    paths, pulses = points_at([30.0, 80.0, 120.0], [1, 1j, -0.5]), make_pulses(1)
    assert receiver.chain.oversampling == 2
    found = receiver.beat(paths, pulses)
    chirp, high_pass = receiver.chirp, receiver.high_pass
    expected = synthesise(high_pass.filtered(paths, chirp), pulses, chirp)
    assert np.abs(found - expected).max() < 5e-3
    assert np.linalg.norm(found - expected) < 1e-3 * np.linalg.norm(expected)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"phase_noise_dbc_hz": [[1e4, -80.0], [1e3, -90.0]]}, "phase_noise_dbc_hz: its offsets must increase"),
        ({"phase_noise_preset": "ti_awr1843aop_76ghz", "phase_noise_dbc_hz": [[1e4, -80.0]]}, "contradicts"),
        ({"phase_noise_preset": "ti_awr1843aop"}, "Did you mean"),
        ({"settling_hz": 1.0}, "settling_time_s: goes with settling_hz"),
        ({"used_window": [0.5, 0.5]}, "used_window: 0.5 to 0.5 is less"),
    ],
)
def test_what_contradicts_itself_is_refused(keys, message):
    with pytest.raises(ScenarioError, match=message):
        load_scenario("hills", {"radar.receiver.oscillator": keys})


def test_an_unknown_stage_is_refused():
    with pytest.raises(ScenarioError, match=r"radar.receiver.stages.mixer.*'magic' is unknown"):
        load_scenario("hills", {"radar.receiver.stages.mixer": "magic"})
