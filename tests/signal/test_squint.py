"""A beam that squints: the beat of its definition, what it costs a Gaussian beam, surveys and refusals."""

from dataclasses import replace

import numpy as np
import pytest

from beams import make_antenna, make_chirp
from direct_receiver import direct_beat, points_at
from flights import make_pulses
from plain_beats import SWEEPS, plain_sum, relative_error
from receivers import radar_with
from sionna_radar import load_scenario, prepare, process, run
from sionna_radar.detection.spectrum import HOST
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.radar.antenna import Antenna, Cut, Squint
from sionna_radar.radar.build import build_antenna, build_sweeps, squinting
from sionna_radar.signal.beat import synthesise
from sionna_radar.signal.build import build_chain
from sionna_radar.signal.receiver import Receiver
from sionna_radar.studies.gradients.study import sensitivities
from sionna_radar.studies.link.study import link_budget as run_link_budget
from sionna_radar.survey.custom_parts import CustomParts
from sionna_radar.survey.sensors.device_radar import DeviceRadar
from sionna_radar.tracing.paths import Paths

RAD_PER_HZ = np.deg2rad(4.0) * 1e-9
KEY = "radar.antenna.squint_deg_per_ghz"
SHORT = {"platform.length_m": 8.0, "terrain.spacing_m": 2.0}


def gaussian(width_deg: float) -> Cut:
    cosine = np.linspace(-1, 1, 8001)
    return Cut(0.5 ** (2 * (cosine / np.sin(np.deg2rad(width_deg))) ** 2))


BEAM = Antenna(gaussian(2.0), gaussian(20.0))


def toward(left_deg, up_deg=0.0):
    left, up = np.broadcast_arrays(np.deg2rad(left_deg), np.deg2rad(up_deg))
    return np.stack([np.cos(up) * np.cos(left), np.cos(up) * np.sin(left), np.sin(up)], axis=-1)


def seen(direction, range_m, gain=1.0, rate_mps=0.0) -> Paths:
    """Return paths of the first of `make_pulses` to points in some directions."""
    pose = make_pulses().true
    place = pose.position_m[0] + np.asarray(range_m)[..., None] * direction @ pose.R_world_antenna[0].T
    return replace(points_at(range_m, gain, rate_mps), hit_m=place)


def followed(antenna, left_deg, up_deg, chirp):
    """Return the two-way amplitude toward a point at each sample: the beam turns left as the frequency rises."""
    turned_deg = np.rad2deg(RAD_PER_HZ * chirp.slope_hz_s * chirp.sample_time_s)
    return antenna.gain(toward(left_deg - turned_deg, up_deg))


def profile(left_deg, chirp, squint):
    """Return the power of a point over frequencies a 64th of a range cell apart, with a Hann window."""
    direction = toward([left_deg])
    antenna = BEAM if squint is None else squint.mean
    beat = synthesise(seen(direction, [30.0], antenna.gain(direction)), make_pulses(), replace(chirp, squint=squint))
    return np.abs(np.fft.fft(beat[0] * np.hanning(chirp.samples), 64 * chirp.samples)) ** 2


def half_power_width(x, power):
    inside = np.flatnonzero(power >= power.max() / 2)
    ends = [
        np.interp(power.max() / 2, power[list(pair)], x[list(pair)])
        for pair in ((inside[0] - 1, inside[0]), (inside[-1] + 1, inside[-1]))
    ]
    return ends[1] - ends[0]


@pytest.mark.parametrize(("sweep", "sampling"), SWEEPS)
@pytest.mark.parametrize("antenna", [BEAM, make_antenna(2.0, 8.0)])
@pytest.mark.parametrize("bandwidth_hz", [0.5e9, 2e9])
def test_the_beat_is_the_sum_of_echoes_that_follow_the_beam(sweep, sampling, antenna, bandwidth_hz):
    chirp = make_chirp(bandwidth_hz=bandwidth_hz, sweep=sweep, sampling=sampling)
    squint = Squint.of(antenna, RAD_PER_HZ, bandwidth_hz)
    left_deg, up_deg = np.array([0.0, -1.3, 2.1, 0.7]), np.array([0.0, 0.4, -5.0, 6.0])
    range_m, rate_mps = np.array([20.0, 24.0, 27.0, 31.0]), 6.0
    direction = toward(left_deg, up_deg)
    phase = np.exp(1j * np.arange(4.0))
    paths = seen(direction, range_m, squint.mean.gain(direction) * phase, rate_mps)
    found = synthesise(paths, make_pulses(), replace(chirp, squint=squint))
    expected = sum(
        followed(antenna, left_deg[k], up_deg[k], chirp)
        * plain_sum(points_at(range_m[k], phase[k], rate_mps), np.array([0]), chirp)
        for k in range(4)
    )
    assert relative_error(found, expected) < 1e-3


@pytest.mark.parametrize("bandwidth_hz", [0.5e9, 1e9, 4e9])
def test_the_mean_antenna_has_the_mean_power_over_the_sweep(bandwidth_hz):
    mean, chirp = Squint.of(BEAM, RAD_PER_HZ, bandwidth_hz).mean, make_chirp(bandwidth_hz=bandwidth_hz)
    for left_deg in (0.0, 1.1, -2.5):
        power = np.mean(followed(BEAM, left_deg, 0.0, chirp) ** 2)
        assert mean.gain(toward([left_deg]))[0] ** 2 == pytest.approx(power, rel=0.02)


@pytest.mark.parametrize(
    ("bandwidth_hz", "loss_db", "cell", "footprint"), [(0.5e9, 0.74, 1.067, 1.091), (1e9, 2.51, 1.265, 1.355)]
)
def test_what_the_squint_costs_a_gaussian_beam(bandwidth_hz, loss_db, cell, footprint):
    """Figures of docs/limits.md, by the beats and by quadrature of the window times the beam."""
    chirp = make_chirp(bandwidth_hz=bandwidth_hz, sampling="iq")
    squint = Squint.of(BEAM, RAD_PER_HZ, bandwidth_hz)
    still, turning = profile(0.0, chirp, None), profile(0.0, chirp, squint)
    bins, left_deg = np.arange(len(still)), np.arange(-3.0, 3.01, 0.1)
    peaks = [np.array([profile(a, chirp, s).max() for a in left_deg]) for s in (None, squint)]
    found = (
        10 * np.log10(still.max() / turning.max()),
        half_power_width(bins, turning) / half_power_width(bins, still),
        half_power_width(left_deg, peaks[1]) / half_power_width(left_deg, peaks[0]),
    )
    assert found == pytest.approx((loss_db, cell, footprint), abs=0.006)

    place = np.linspace(-0.5, 0.5, 2001)
    window, cells = np.cos(np.pi * place) ** 2, np.arange(0, 3, 0.002)

    def beam(a):
        return 0.5 ** (4 * ((a - np.rad2deg(RAD_PER_HZ) * bandwidth_hz * place) / 2.0) ** 2)

    sums = [np.abs(np.exp(2j * np.pi * np.outer(cells, place)) @ (window * b)) ** 2 for b in (1.0, beam(0.0))]
    widths = [np.interp(-0.5, -s[:700] / s[0], cells[:700]) for s in sums]
    wide = half_power_width(left_deg, np.array([np.sum(window * beam(a)) ** 2 for a in left_deg]))
    expected = 10 * np.log10(sums[0][0] / sums[1][0]), widths[1] / widths[0], wide / np.sqrt(2)
    assert found == pytest.approx(expected, abs=0.003)


def test_the_mixer_follows_the_beam_and_leaves_leakage_as_it_is():
    bend = {"oscillator": {"quadratic_hz": 2e5}}
    leak = {"leakage": [{"delay_ns": 60.0, "level_db": 0.0}]}
    radar = radar_with(bend | leak, sampling="iq")
    squint = Squint.of(BEAM, RAD_PER_HZ, radar.bandwidth_hz)
    sweeps = tuple(replace(sweep, squint=squint) for sweep in build_sweeps(radar))
    chirp = sweeps[0]
    receiver = Receiver(
        sweeps=sweeps,
        transmit_power_w=1.0,
        noise_power_w=0.0,
        seed=5,
        high_pass=None,
        chain=build_chain(radar, sweeps, None),
    )
    direction = toward([0.8])
    beat = receiver.beats(seen(direction, [20.0], squint.mean.gain(direction) / BEAM.peak_gain), make_pulses())[0][0]

    def error_rad(t):
        return 2 * np.pi * 2e5 * 4 * t**3 / (3 * chirp.duration_s**2)

    echo, leaking = (
        direct_beat(points_at(r), chirp, chirp.sample_time_s, error_rad) for r in (20.0, 60e-9 * 299_792_458.0 / 2)
    )
    expected = followed(BEAM, 0.8, 0.0, chirp) / BEAM.peak_gain * echo + leaking
    # The mixer's own interpolation, with and without squint.
    np.testing.assert_allclose(beat, expected, atol=2e-3)


def test_a_survey_with_squint_is_recorded_and_processed_on_the_host(tmp_path):
    scenario = load_scenario("hills", SHORT | {KEY: 4.0})
    survey = run(scenario, recordings={"signals": tmp_path / "signals.nc"})
    processed = process(tmp_path / "signals.nc")
    np.testing.assert_array_equal(processed.points.range_m, survey.points.range_m)
    np.testing.assert_array_equal(processed.dem.height_m, survey.dem.height_m)
    device = run(scenario, parts=CustomParts(sensor=lambda given: DeviceRadar(given, HOST)))
    assert not device.sensor.on_device
    np.testing.assert_array_equal(device.points.range_m, survey.points.range_m)


def test_without_squint_sweeps_and_antenna_are_those_of_the_tables():
    scenario = load_scenario("hills", SHORT)
    antenna, sweeps = build_antenna(scenario.radar.antenna), build_sweeps(scenario.radar)
    same, unchanged = squinting(scenario.radar.antenna, antenna, sweeps)
    assert same is antenna
    assert unchanged is sweeps


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"sensor": "mimo"}, "is not supported with frames of an array; set 0"),
        (
            {"processing.angle": "interferometric", "radar.second_receiver.axis": "both"},
            "is not supported with several receivers; set 0, or processing.angle = 'off'",
        ),
        ({"weather.rain_rate_mm_per_h": 5.0}, "is not supported with rain, snow or dust"),
        ({"tracing.bounces": 2}, "set 0, or tracing.bounces = 1"),
    ],
)
def test_what_a_squint_contradicts_is_named(keys, words):
    with pytest.raises(ScenarioError, match=f"{KEY}: 4 .*{words}"):
        load_scenario("hills", SHORT | {KEY: 4.0} | keys)


def test_studies_of_a_still_beam_and_turns_of_many_widths_are_refused():
    scenario = load_scenario("hills", SHORT | {KEY: 4.0})
    with pytest.raises(ScenarioError, match=f"{KEY}: 4: a link budget assumes a beam that does not move"):
        run_link_budget(scenario)
    with pytest.raises(ScenarioError, match="a derivative assumes a beam that does not move"):
        sensitivities(prepare(scenario), [0], of=["echo_power"], to=["pose.up_m"])
    with pytest.raises(ScenarioError, match="turns the beam by 20 of its widths, more than 10; lower it"):
        prepare(load_scenario("hills", SHORT | {KEY: 80.0}))
