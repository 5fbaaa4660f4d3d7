"""A range gate: the beat of its closed form, and surveys behind it like those with more samples."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import KDTree

from beams import make_chirp
from direct_receiver import C, points_at
from flights import make_pulses
from plain_beats import SWEEPS
from sionna_radar import load_scenario, prepare, process, run
from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.signal.analog_filters import HighPass
from sionna_radar.signal.beat import synthesise
from sionna_radar.studies.gradients.study import sensitivities
from sionna_radar.studies.link.study import link_budget as run_link_budget
from sionna_radar.survey.result import Survey

pytestmark = pytest.mark.usefixtures("rough_errors")

CELLS, BANDWIDTH_HZ = 100, 500e6
# Without noise, and as few paths as show an echo.
STILL = {"platform.length_m": 6.0, "terrain.spacing_m": 2.0, "radar.snr_db": 150.0}


def gated(cells: float, samples: int, sampling: str = "real") -> dict[str, object]:
    """Return a gate of some range cells, with as many samples less as reach as far."""
    each = 2 if sampling == "real" else 1
    kept = {"radar.sampling": sampling, "radar.samples_per_chirp": samples - each * round(cells)}
    return kept | {"radar.gate_delay_us": 1e6 * cells / BANDWIDTH_HZ}


@pytest.mark.parametrize(("sweep", "sampling"), SWEEPS)
@pytest.mark.parametrize("range_m", [80.0, 20.0])
def test_the_beat_is_the_sent_wave_of_the_gate_against_that_of_the_echo(sweep, sampling, range_m):
    chirp = replace(make_chirp(sweep=sweep, sampling=sampling), gate_s=0.2e-6)
    rate_mps, gain, slope = 9.0, 3e-5 * np.exp(0.7j), chirp.slope_hz_s

    def turns(time_s):
        """Return the phase of the sent wave, whose sweep has its middle at the time zero."""
        return chirp.carrier_hz * time_s + slope * time_s**2 / 2

    # The pulse's pose is that of the middle of the samples, which are as late as the gate.
    since_pose_s = chirp.sample_time_s
    sent_s, delay_s = since_pose_s + chirp.gate_s, 2 * (range_m + rate_mps * since_pose_s) / C
    cycles = turns(sent_s - chirp.gate_s) - turns(sent_s - delay_s)
    expected = np.conj(gain) * np.exp(2j * np.pi * cycles)
    expected = np.conj(expected) if sweep == "down" else expected
    # An echo before the gate, here 30 m away, has a negative beat: the filter of I/Q samples removes it.
    if range_m < chirp.gate_m and sampling == "iq":
        expected = np.zeros_like(expected)
    expected = expected if sampling == "iq" else np.sqrt(2) * expected.real
    found = synthesise(points_at(range_m, gain, rate_mps), make_pulses(1), chirp)
    np.testing.assert_allclose(found[0], expected, atol=1e-6 * 3e-5)


@pytest.mark.parametrize("sampling", ["real", "iq"])
@pytest.mark.parametrize("cells", [100, 100.37])
@pytest.mark.parametrize("high_pass", [None, HighPass(corner_hz=40e3, order=1)])
def test_an_echo_behind_the_gate_peaks_at_its_range_with_its_power(sampling, cells, high_pass):
    chirp = replace(make_chirp(sampling=sampling), gate_s=cells / BANDWIDTH_HZ)
    analyser = SpectrumAnalyser(chirp, "hann", 4, high_pass)
    cell = 200
    paths = points_at(cell * chirp.range_resolution_m)
    beat = synthesise(paths if high_pass is None else high_pass.filtered(paths, chirp), make_pulses(1), chirp)
    power = analyser.power(beat)[0]
    peak = int(np.argmax(power))
    assert analyser.range_m[peak] == pytest.approx(cell * chirp.range_resolution_m)
    assert power[peak] == pytest.approx(1.0, rel=2e-3)
    assert analyser.range_m[0] == pytest.approx(chirp.first_cell * chirp.range_resolution_m)
    assert 0 <= analyser.range_m[0] - chirp.gate_m < chirp.range_resolution_m


def test_a_nearer_echo_folds_into_real_samples():
    chirp = replace(make_chirp(), gate_s=CELLS / BANDWIDTH_HZ)
    analyser, before_m = SpectrumAnalyser(chirp, "hann", 1), 10.0
    beat = synthesise(points_at(chirp.gate_m - before_m), make_pulses(1), chirp)
    read_m = analyser.range_m[np.argmax(analyser.power(beat)[0])]
    assert read_m == pytest.approx(chirp.gate_m + before_m, abs=chirp.range_resolution_m)


def flown(cells: float, sampling: str, keys: dict[str, object]) -> tuple[Survey, Survey]:
    """Return a survey without a gate, and the same behind one."""
    usual = {"radar.sampling": sampling, "radar.samples_per_chirp": 1024 if sampling == "real" else 512} | keys
    behind = usual | gated(cells, usual["radar.samples_per_chirp"], sampling)
    return run(load_scenario("hills", STILL | usual)), run(load_scenario("hills", STILL | behind))


@pytest.mark.parametrize(
    ("cells", "sampling", "keys", "within_m"),
    [
        (CELLS, "real", {"dem.method": "refined"}, 2e-3),
        (CELLS, "iq", {"dem.method": "stepped", "radar.snr_db": 60.0}, 0.1),
        (CELLS, "iq", {"dem.method": "smooth", "radar.sweep": "triangular", "platform.speed_mps": 5.0}, 2e-3),
        (100.37, "real", {"dem.method": "linear", "radar.sweep": "down"}, 2e-3),
        (100.37, "real", {"dem.method": "linear", "radar.receiver.high_pass_corner_hz": 2e4}, 2e-3),
        # The fit of noise-free echoes answers to 40 samples more, without a gate, by up to 0.03 m.
        (100.37, "iq", {"dem.method": "linear", "processing.ranging": "model_fit"}, 0.1),
    ],
)
def test_a_survey_behind_the_gate_is_that_of_more_samples(cells, sampling, keys, within_m):
    usual, behind = flown(cells, sampling, keys)
    assert len(behind.points) == len(usual.points) > 50
    assert np.abs(behind.points.range_m - usual.points.range_m).max() < within_m
    both = usual.dem.filled & behind.dem.filled
    assert both.sum() > 0.95 * usual.dem.filled.sum()
    assert np.quantile(np.abs(usual.dem.height_m - behind.dem.height_m)[both], 0.9) < within_m


def test_directions_behind_the_gate_are_as_near_as_those_of_other_samples():
    angle = {"processing.angle": "interferometric", "radar.second_receiver.axis": "both", "dem.method": "linear"}
    usual, behind = flown(CELLS, "real", angle)
    # Stretches of an echo begin and end elsewhere with other samples, and points move along it.
    other = run(load_scenario("hills", STILL | angle | {"radar.samples_per_chirp": 840}))
    place = KDTree(usual.points.position_m)
    gated_m, other_m = (np.median(place.query(s.points.position_m)[0]) for s in (behind, other))
    assert len(behind.points) == pytest.approx(len(usual.points), rel=0.05)
    assert gated_m < 2 * other_m < 1.0


def test_derivatives_of_a_profile_stand_in_the_cells_behind_the_gate():
    short = STILL | {"tracing.paths_per_pulse": 32}
    of, to = ["profile"], ["pose.up_m"]
    usual, behind = (
        sensitivities(prepare(load_scenario("hills", short | k)), [10], of=of, to=to) for k in ({}, gated(CELLS, 1024))
    )
    np.testing.assert_allclose(behind.range_m, usual.range_m[CELLS:])
    expected = usual["profile", "pose.up_m"][:, CELLS:]
    np.testing.assert_allclose(behind["profile", "pose.up_m"], expected, atol=1e-3 * np.abs(expected).max())


def test_a_recording_keeps_the_gate(tmp_path):
    survey = run(
        load_scenario("hills", STILL | gated(100.37, 1024) | {"dem.method": "refined"}),
        recordings={"signals": tmp_path / "signals.nc"},
    )
    processed = process(tmp_path / "signals.nc")
    np.testing.assert_array_equal(processed.points.range_m, survey.points.range_m)
    np.testing.assert_array_equal(processed.dem.height_m, survey.dem.height_m)


@pytest.mark.parametrize("kind", ["sample", "range", "power"])
def test_a_described_array_is_read_behind_the_gate(tmp_path, kind):
    rng, samples, rate_hz, range_m = np.random.default_rng(1), 256, 2.5e6, 1234.5
    bandwidth_hz, gate_us = 200e6, 8.0
    time_s = np.arange(samples) / rate_hz
    slope = bandwidth_hz * rate_hz / samples
    beat = 30 * np.exp(2j * np.pi * slope * (2 * range_m / C - 1e-6 * gate_us) * time_s)
    beat = beat + rng.normal(size=(40, samples, 2)) @ np.array([1, 1j])
    profile = np.fft.fft(beat * np.hanning(samples), norm="forward")
    values = {"sample": beat, "range": np.fft.fft(beat, norm="forward"), "power": np.abs(profile) ** 2}[kind]
    np.save(tmp_path / "array.npy", values)
    text = f"""
[recording]
samples = "array.npy"
axes = ["pulse", "{"sample" if kind == "sample" else "range"}"]
{'values = "power"' if kind == "power" else ""}
[sweep]
carrier_hz = 94e9
bandwidth_hz = {bandwidth_hz}
sampling_rate_hz = {rate_hz}
pulse_rate_hz = 100.0
gate_delay_us = {{}}
"""
    (tmp_path / "described.toml").write_text(text.format(gate_us))
    assert np.median(process(tmp_path / "described.toml").echoes.range_m) == pytest.approx(range_m, abs=0.05)
    if kind == "power":
        (tmp_path / "described.toml").write_text(text.format(gate_us + 0.0012))
        with pytest.raises(ScenarioError, match=r"sweep.gate_delay_us: 8.0012 ends 0.76 cells .* set 8.005"):
            process(tmp_path / "described.toml")


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"radar.gate_delay_us": -1.0}, "radar.gate_delay_us"),
        ({"radar.gate_delay_us": 900.0, "radar.chirp_rate_hz": 2000.0}, "radar.gate_delay_us: 900 is no shorter than"),
        (
            {"weather.rain_rate_mm_per_h": 5.0},
            "'auto' is not supported with rain, snow or dust before",
        ),
        ({"sensor": "mimo"}, "radar.gate_delay_us: 0.2 is not supported with frames of an array; set 0"),
    ],
)
def test_what_a_gate_contradicts_is_named(keys, words):
    with pytest.raises(ScenarioError, match=words):
        load_scenario("hills", {"radar.gate_delay_us": 0.2} | keys)


def test_ground_before_the_gate_and_studies_of_near_ranges_are_refused():
    with pytest.raises(
        ScenarioError, match=r"nearer than the 149.9 m of the range gate; lower radar.gate_delay_us to 0.4"
    ):
        prepare(load_scenario("hills", {"radar.gate_delay_us": 1.0}))
    with pytest.raises(ScenarioError, match="a link budget assumes ranges from zero on; set 0"):
        run_link_budget(load_scenario("hills", {"radar.gate_delay_us": 0.2}))
