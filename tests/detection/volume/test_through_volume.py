"""Ground behind rain: the volume's mean from the survey, false alarms, and maps that keep to the ground."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from sionna_radar import load_scenario, run
from sionna_radar.detection.volume.clutter import VolumeClutter, expected_motion, first_guess
from sionna_radar.detection.volume.echo_widths import MIN_SLOPE_WEIGHT
from sionna_radar.detection.volume.end import LARGEST_LOSS, NEGLIGIBLE, Views, _spans
from sionna_radar.detection.volume.estimation import _cells, shows_volume
from sionna_radar.detection.volume.ground import SLOPES, unknown_ground
from sionna_radar.detection.volume.height_track import AxisHeights, track
from sionna_radar.detection.volume.shapes import WIDTHS_CELLS, beam_sigma, ground_shapes
from sionna_radar.execution.execution import Execution
from sionna_radar.radar.equation import two_way_beam_sr
from sionna_radar.survey.observation import observe
from sionna_radar.survey.preparation import prepare
from sionna_radar.survey.sensors import sweeps
from sionna_radar.survey.sensors.radar import Radar
from sionna_radar.survey.warnings import shared_warnings
from sionna_radar.tracing.build import build_weather
from sionna_radar.weather.path import rain_clutter_power

SMALL = {"platform.length_m": 10.0, "tracing.paths_per_pulse": 96}
LINEAR = {"dem.method": "linear"}


@cache
def rainy(rate, scene="hills", **keys):
    changes = {"weather.rain_rate_mm_per_h": rate, **SMALL} | {k.replace("__", "."): v for k, v in keys.items()}
    return load_scenario(scene, changes)


@cache
def flown(rate, **keys):
    return run(rainy(rate, **keys))


def false_heights(survey):
    error = survey.error.height_m[survey.lit & np.isfinite(survey.error.height_m)]
    return float(np.mean(np.abs(error) > 1.0))


@cache
def through(rate):
    ready = prepare(rainy(rate))
    sensor = Radar(ready.sensor_inputs())
    return ready, sensor, sensor.sweeps.through[0]


def test_drops_that_fold_onto_the_first_cells_bend_no_law():
    """Ahead, a real signal shows drops up to 5 m away from 0 to 5 m; complex samples tell them apart."""
    keys = {
        "weather.rain_rate_mm_per_h": 12.0,
        "radar.bandwidth_hz": 300e6,
        "radar.chirp_rate_hz": 400.0,
        "radar.samples_per_chirp": 512,
        "radar.antenna.beamwidth_deg": 3.0,
        "radar.scan": {"mode": "conical", "incidence_deg": 65.0, "half_swath_deg": 12.0, "rotation_rpm": 401.0},
        "platform.altitude_m": 20.0,
        "platform.speed_mps": 20.0,
        "platform.length_m": 120.0,
        "tracing.paths_per_pulse": 96,
        "seed": 6,
        **LINEAR,
    }
    real, complex_samples = (run(load_scenario("hills", keys | {"radar.sampling": kind})) for kind in ("real", "iq"))
    assert real.lit_error.rms_m < 1.4 * complex_samples.lit_error.rms_m
    assert real.lit_error.coverage > 0.95 * complex_samples.lit_error.coverage


@pytest.mark.parametrize("rate", [pytest.param(1.0, marks=pytest.mark.study), 25.0])
def test_the_mean_of_rain_is_found_without_being_told(rate):
    ready, _, found = through(rate)
    chirp, antenna, window = ready.receiver.chirp, ready.instrument.antenna, ready.instrument.detector.analyser.window
    weather = build_weather(ready.scenario.weather, chirp.carrier_hz)
    cells = np.arange(20, 200)
    # On the axis of the spectrum, where the platform's motion and the fall of the drops move it.
    pose = ready.flight.sample(200).true
    rate_mps = pose.boresight_range_rate_mps - weather.rain_speeds().at(np.array([0.5])) * pose.boresight[:, 2]
    shift_m = float(chirp.doppler_range_m(rate_mps).mean())
    known = rain_clutter_power(
        (np.append(cells, 200) - 0.5) * chirp.range_resolution_m - shift_m,
        reflectivity_per_m=weather.rain_reflectivity_per_m,
        two_way_beam_sr=two_way_beam_sr(antenna),
        peak_gain=antenna.peak_gain,
        wavelength_m=chirp.wavelength_m,
        specific_attenuation_db_per_km=0.0,
    )
    # What a window makes of noise. The loss on the way is left out: 0.7 dB over 24 m of 25 mm/h, 2 dB over 60 m.
    known *= ready.receiver.transmit_power_w * len(window) * np.sum(window**2)
    error_db = 10 * np.log10(found.volume.mean[cells] / known)
    near = cells < 80
    assert np.abs(error_db[near]).max() < 0.9
    assert -2.5 < error_db[~near].mean() < 0.3


@pytest.mark.parametrize("rate", [pytest.param(1.0, marks=pytest.mark.study), 25.0])
def test_rain_is_expected_to_fall_as_its_echo_is_strong(rate):
    _, _, found = through(rate)
    told = expected_motion(77e9, rate).velocity_mps[2]
    assert found.motion.velocity_mps[2] == pytest.approx(told, abs=0.1)
    assert abs(told - expected_motion(77e9, 5.0).velocity_mps[2]) > 0.2


def test_wind_is_told_from_all_cells_that_the_window_keeps_clear():
    """With cells from the fourth beyond the main lobe on only, it errs by 1.2 m/s, of 1.2 stated."""
    ready = prepare(rainy(10.0, seed=3, weather__wind_mps=(10.0, 0.0, 0.0)))
    motion = Radar(ready.sensor_inputs()).sweeps.through[0].motion
    boresight = ready.flight.sample(60).measured.boresight
    error_mps = motion.range_rate_mps(boresight) - boresight @ [10.0, 0.0, expected_motion(77e9, 10.0).velocity_mps[2]]
    sigma_mps = motion.sigma_mps(boresight)
    assert np.sqrt(np.mean(error_mps**2)) < 1.0
    assert np.all(sigma_mps < 1.1)
    assert np.mean((error_mps / sigma_mps) ** 2) < 2.0


def test_clear_air_is_none_and_loses_no_bit():
    ready = prepare(rainy(0.0))
    pulses = ready.flight.sample(40)
    sensor = Radar(ready.sensor_inputs())
    power = ready.instrument.detector.analyser.power(ready.receiver.beat(sensor.tracer.trace(pulses), pulses))
    assert not shows_volume(ready.instrument.detector, power, pulses)
    off = run(rainy(0.0, processing__volume_clutter="off"))
    assert flown(0.0).points.sha256() == off.points.sha256()


def test_ground_at_one_range_is_no_volume():
    """A beam that stands still meets level ground at one range in every pulse, as rain would; it falls otherwise."""
    rng = np.random.default_rng(1)
    range_m = 0.3 * np.arange(400)
    mean = 1e-9 + 1e-4 * np.exp(-(((range_m - 9.0) / 1.5) ** 2))
    assert first_guess(rng.exponential(mean, (60, 400)), range_m, 10, 398) is None
    volume = 1e-9 + 1e-5 / np.maximum(range_m, 0.3) ** 2
    assert first_guess(rng.exponential(volume, (60, 400)), range_m, 10, 398) is not None


def test_rain_before_near_ground_is_a_volume_and_ground_of_varying_range_is_none():
    rng = np.random.default_rng(3)
    range_m = 1.5 * np.arange(120)
    ground = rng.uniform(7.0, 11.0, (200, 1))
    lobe = 1e-4 * np.exp(-(((np.arange(120) - ground) / 1.2) ** 2))
    rain = np.where(np.arange(120) < ground, 1e-3 / np.maximum(range_m, 1.5) ** 2, 0.0)
    found = first_guess(rng.exponential(1e-12 + rain + lobe), range_m, 3, 118, narrow=True)
    assert found is not None
    np.testing.assert_allclose(found.mean[3:8] * range_m[3:8] ** 2, 1e-3, rtol=0.3)
    assert first_guess(rng.exponential(1e-12 + rain + lobe), range_m, 3, 118) is None
    for low, high in ((4.0, 9.0), (3.0, 14.0), (6.0, 6.5), (5.4, 5.6)):
        lobe = 1e-4 * np.exp(-(((np.arange(120) - rng.uniform(low, high, (200, 1))) / 1.2) ** 2))
        assert first_guess(rng.exponential(1e-12 + lobe), range_m, 3, 118, narrow=True) is None


@pytest.mark.parametrize(
    "keys", [{"radar.scan": {"mode": "conical", "incidence_deg": 40.0, "rotation_rpm": 397.0}}, {}]
)
def test_a_low_flight_of_coarse_cells_maps_the_ground_behind_rain(keys):
    """The ground lies some ten cells from the radar: without a volume the map is 3.8 m too high."""
    low = {"platform.altitude_m": 10.0, "platform.length_m": 12.0, "platform.speed_mps": 5.0}
    low |= {"radar.bandwidth_hz": 120e6, "radar.samples_per_chirp": 128, "radar.antenna.beamwidth_deg": 2.5}
    low |= {"weather.rain_rate_mm_per_h": 2.0, "radar.chirp_rate_hz": 1500.0, "tracing.paths_per_pulse": 96}
    survey = run(load_scenario("two_fields", low | keys))
    assert survey.lit_error is not None
    assert survey.lit_error.rms_m < 0.6
    assert survey.lit_error.coverage > 0.75


def test_sweeps_so_long_that_drops_may_fold_over_all_ranges_leave_half_of_the_cells():
    slow = {"radar.scan": {"mode": "fixed", "incidence_deg": 30.0}, "radar.chirp_rate_hz": 100.0}
    slow |= {"radar.bandwidth_hz": 100e6, "radar.samples_per_chirp": 128, "radar.sampling": "iq"}
    ready = prepare(load_scenario("hills", slow | {"platform.length_m": 20.0, "weather.rain_rate_mm_per_h": 10.0}))
    pulses = ready.flight.sample(20)
    assert _cells(ready.instrument.detector, pulses, ready.instrument.sweeps[0]) == 64


@pytest.mark.parametrize("pulses", [4, 12, 48, 256])
def test_noise_of_few_pulses_is_no_volume(pulses):
    """The quietest of its cells seem to hold much less than the rest: half of it in twelve pulses."""
    rng = np.random.default_rng(pulses)
    range_m = 0.15 * np.arange(500)
    power = rng.exponential(size=(80, pulses, 500))
    found = [first_guess(each, range_m, first, 498, narrow=True) for first, each in enumerate(power, 10)]
    assert sum(guess is not None for guess in found) <= 1


def test_rain_without_ground_makes_no_echo():
    ready, _, found = through(25.0)
    end, volume = found.end, found.volume
    rng = np.random.default_rng(2)
    beat = rng.normal(size=(400, 2, ready.receiver.chirp.samples)) / np.sqrt(2)
    white = (
        np.abs(np.fft.fft((beat[:, 0] + 1j * beat[:, 1]) * ready.instrument.detector.analyser.window)[:, : end.cells])
        ** 2
    )
    power = white / white.mean() * volume.background
    views = Views(down=np.full(400, 0.6), shift_m=np.zeros(400), drift_m=np.full(400, 1.1), strength=np.ones(400))
    level_weight = np.tile(end.ground.level_weight, (400, 1))
    by_width = end.by_width(end.over_volume(power, views.strength), views, level_weight)
    evidence = end.evidence(by_width, views, end.ground.slope_weight[None])[0]
    heights = AxisHeights(
        position_m=np.column_stack([np.arange(400.0), np.zeros(400), np.full(400, 50.0)]),
        boresight=np.tile([0.8, 0.0, -0.6], (400, 1)),
        shift_m=np.zeros(400),
    )
    tracked = track(evidence[:, : end.cells], heights, end.cell_m, np.arange(400) // 50, 0.1, end.cell_m)
    accepted = (tracked.evidence > -np.log(1e-6)) & (tracked.probability > 0.99)
    assert not accepted.any()
    above = power[:, end.first :] > volume.clutter_threshold(1e-3)[end.first :]
    assert above.mean() == pytest.approx(1e-3, rel=0.3)


@pytest.mark.parametrize(
    "rate", [pytest.param(1.0, marks=pytest.mark.study), pytest.param(10.0, marks=pytest.mark.study), 25.0]
)
def test_hills_are_mapped_in_rain(rate):
    clear, wet = flown(0.0), flown(rate)
    assert wet.lit_error.coverage > 0.95 * clear.lit_error.coverage
    assert wet.lit_error.rms_m < 0.22
    assert false_heights(wet) <= 0.005
    assert wet.warnings == ()


def test_hills_are_mapped_in_rain_that_a_headwind_carries():
    """The drops come towards the radar, so that their end is read metres short of the ground that ends them."""
    survey = run(rainy(4.0, weather__wind_mps=(-10.0, 0.0, 0.0)))
    assert survey.lit_error.rms_m < 0.28
    assert survey.lit_error.coverage > 0.9 * flown(0.0).lit_error.coverage
    assert false_heights(survey) <= 0.005


def test_rain_in_still_air_over_rugged_ground_shows_no_wind():
    """From every other pulse of the sample a wind of 3 m/s was found here, and the map stood 0.5 m too high."""
    flight = {"platform.length_m": 55.0, "seed": 51, "terrain.seed": 51}
    survey = run(load_scenario("ridges", flight | {"weather.rain_rate_mm_per_h": 20.0} | LINEAR))
    assert abs(survey.lit_error.mean_m) < 0.1
    assert survey.lit_error.rms_m < 0.25


def test_maps_under_the_track_have_no_bias_in_rain():
    """Echoes there are narrower than a range cell; the narrowest that was tried was a cell wide, and maps stood 0.23 m
    too high.
    """
    scan = {"incidence_deg": 0.0, "half_swath_deg": 45.0, "rotation_rpm": 300.0}
    radar = {"transmit_power_dbm": 12.0, "noise_figure_db": 15.0, "bandwidth_hz": 400e6, "chirp_rate_hz": 1000.0}
    radar |= {"antenna": {"beamwidth_deg": 2.0}, "scan": scan}
    flight = {"platform.altitude_m": 25.0, "platform.length_m": 6.0, "radar": radar}
    survey = run(load_scenario("hills", flight | {"weather.rain_rate_mm_per_h": 4.0} | LINEAR))
    assert abs(survey.lit_error.mean_m) < 0.06
    assert survey.lit_error.rms_m < 0.15


@pytest.mark.parametrize("rain_mm_per_h", [5.0, 20.0])
def test_at_grazing_incidence_rain_ends_at_the_ground(rain_mm_per_h):
    """At 75 deg an echo is 30 cells long, and its far tail decides where the rain ends.

    With the tail of a parabola in place of a plane's, and levels of the ground that could not come back once they were
    out, maps of this flight were 0.46 m too low at 5 mm/h.
    """
    flat = {"kind": "flat", "size_m": [700.0, 400.0]}
    flight = {"terrain": flat, "wires": [], "platform.length_m": 20.0, "weather.rain_rate_mm_per_h": rain_mm_per_h}
    survey = run(load_scenario("power_line", flight | LINEAR))
    assert abs(survey.lit_error.mean_m) < 0.25
    assert survey.dem_uncertainty.cells.coverage["95"] > 0.85


def test_the_slope_of_the_ground_does_not_move_ranges():
    """On the axis, ranges err by -1.9 m per unit of slope here, alike in neighbouring lines; beside it by 0.2 m
    on average, with a scatter of 0.3 m from seed to seed; the bound lies two of these above.
    """
    flight = {"weather.rain_rate_mm_per_h": 8.0, "platform.length_m": 15.0, "seed": 9}
    ready = prepare(load_scenario("ridges", flight | LINEAR))
    points, caster = run(ready).points, ready.world.caster
    pose = ready.flight.pulses(points.pulse).true
    toward = (points.position_m - points.origin_m) / points.range_m[:, None]
    hit = caster.intersect(caster.prepare(pose.position_m, toward))
    normal = np.array([hit.n.x, hit.n.y, hit.n.z])
    level = pose.boresight[:, :2] / np.linalg.norm(pose.boresight[:, :2], axis=1, keepdims=True)
    rises = -np.sum(normal[:2].T * level, axis=1) / normal[2]
    per_slope = np.polyfit(rises, points.range_m - np.asarray(hit.t), 1)[0]
    assert abs(per_slope) < 0.8


@pytest.mark.parametrize("number", [10, 16])
def test_the_shape_of_an_echo_is_that_of_a_plane_of_constant_gamma(number):
    """Its mean beyond the axis is q, for the longer far side; the volume that it is told over falls as r^-2, too."""
    end, range_cells = through(25.0)[2].end, 300
    beam, half = (end.beam.sine.tobytes(), end.beam.power.tobytes()), 40
    square, width = end.beam.power @ end.beam.sine**2, WIDTHS_CELLS[number]
    (ground,) = ground_shapes(half, range_cells, np.array([width]).tobytes(), *beam, end.response.tobytes())
    mean = ground @ np.arange(-half, half + 1)
    assert mean == pytest.approx(range_cells * square / 2 + width**2 / range_cells, abs=0.03 * width**2 / range_cells)


def test_an_unknown_motion_of_the_rain_moves_all_ranges_with_it():
    """Beside what is learned of the ground's level and the volume's mean, in squares, and in proportion."""
    end = through(25.0)[2].end
    of = [end.shared_sigma_cells(200, 0.7, 256, 1e4, (1.0, sigma_m)) for sigma_m in (0.0, 1.0, 2.0)]
    assert 0.0 < of[0] < of[1] < of[2]
    assert of[2] ** 2 - of[0] ** 2 == pytest.approx(4 * (of[1] ** 2 - of[0] ** 2))
    # The end of the rain moves with its drops; the ground's own echo, hundreds of times as strong, does not.
    assert of[1] ** 2 - of[0] ** 2 < (1.0 / end.cell_m) ** 2


def test_wind_that_long_sweeps_hide_is_in_what_is_stated():
    """Sweeps of 1.4 ms, 25 m up: drops in a wind of 7 m/s ahead fold over all cells in front of the ground."""
    changes = {
        "weather.rain_rate_mm_per_h": 8.0,
        "weather.wind_mps": [7.0, 0.0, 0.0],
        "platform.altitude_m": 25.0,
        "platform.speed_mps": 8.0,
        "platform.length_m": 12.0,
        "radar.bandwidth_hz": 200e6,
        "radar.samples_per_chirp": 256,
        "radar.chirp_rate_hz": 700.0,
        "radar.scan.rotation_rpm": 397.0,
        "radar.antenna.beamwidth_deg": 3.0,
        "tracing.paths_per_pulse": 96,
        "seed": 6,
    }
    survey = run(load_scenario("hills", changes | LINEAR))
    stated_m = np.median(survey.dem_sigma.height_m[survey.lit & survey.dem.filled])
    assert abs(survey.lit_error.mean_m) > 0.6
    assert abs(survey.lit_error.mean_m) < 2.5 * stated_m
    assert not list(shared_warnings(survey.points, 0.75, "rain"))
    assert "may be off together" in next(shared_warnings(survey.points, 0.3, "rain"))


def test_off_takes_rain_for_ground():
    survey = flown(4.0, processing__volume_clutter="off")
    assert not survey.lit_error.coverage > 0.5 or survey.lit_error.rms_m > 5


def test_whole_scan_lines_make_the_result_whatever_the_block_size(monkeypatch):
    # What is learned of the rain is learned once, before any block; here of fewer pulses.
    monkeypatch.setattr(sweeps, "VOLUME_PULSES", 64)
    ready = prepare(rainy(25.0, platform__length_m=4.0))
    one, all_at_once = (observe(ready, Execution(block_size=size))[1].echoes for size in (1, 1000))
    for name in ("pulse", "range_m", "range_sigma_m", "power", "echo_snr_db"):
        np.testing.assert_array_equal(getattr(one, name), getattr(all_at_once, name))
    assert len(one) > 0.9 * len(ready.flight)


def test_evidence_beyond_what_float32_tells_apart_is_still_evidence():
    _, _, through_rain = through(25.0)
    ratio = np.ones((1, through_rain.end.cells))
    ratio[:, 92:108] = 1e10
    views = Views(down=np.full(1, 0.7), shift_m=np.zeros(1), drift_m=np.zeros(1), strength=np.ones(1))
    likelihood, cell = through_rain.end.by_slope_and_level(ratio, views)
    assert np.all(np.isfinite(likelihood))
    assert likelihood.max() > 15 * 2**24
    assert 80 < cell[0] < 120


def test_the_neighbours_decide_between_two_ranges():
    """One pulse of a line has a stronger false range far from what its neighbours see."""
    cell = np.arange(300)
    evidence = np.full((21, 300), -20.0) + 60 * np.exp(-(((cell - 200) / 3.0) ** 2))
    evidence[10] = -20 + 25 * np.exp(-(((cell - 200) / 3.0) ** 2)) + 28 * np.exp(-(((cell - 80) / 3.0) ** 2))
    heights = AxisHeights(
        position_m=np.column_stack([2.0 * np.arange(21), np.zeros(21), np.full(21, 50.0)]),
        boresight=np.tile([0.0, 0.7, -0.7], (21, 1)) / np.sqrt(0.98),
        shift_m=np.zeros(21),
    )
    together = track(evidence, heights, 0.3, np.zeros(21, dtype=int), 0.12, 0.3)
    assert abs(together.cell[10] - 200) < 1
    assert together.probability[10] > 0.9
    alone = track(evidence, heights, 0.3, np.arange(21), 0.12, 0.3)
    assert abs(alone.cell[10] - 80) < 1


def test_the_volume_is_never_below_nothing():
    volume = VolumeClutter(mean=np.ones(3), noise=0.5)
    np.testing.assert_allclose(volume.background, 1.5)
    np.testing.assert_allclose(volume.clutter_threshold(np.exp(-2.0)), 3.0)


@pytest.mark.study
def test_the_rain_scene_is_a_map():
    survey = run(load_scenario("rain", SMALL))
    assert survey.lit_error.rms_m < 0.2
    assert false_heights(survey) <= 0.005


def test_the_long_echoes_at_the_ends_of_a_scan_are_among_the_widths_compared():
    """At 62 deg a beam of 4 deg is 16 cells long, at the middle of the scan 6: the widest of `WIDTHS_CELLS` is 14."""
    keys = {
        "terrain": {"kind": "flat", "size_m": [400.0, 400.0]},
        "platform.altitude_m": 60.0,
        "platform.length_m": 40.0,
        "radar.antenna.beamwidth_deg": 4.0,
        "radar.snr_db": None,
        "radar.transmit_power_dbm": 10.0,
        "radar.noise_figure_db": 12.0,
        "materials.ground": {"model": "constant_gamma", "gamma_db": -12.0},
        "weather.rain_rate_mm_per_h": 10.0,
        **LINEAR,
    }
    points = run(load_scenario("hills", keys)).points
    ends = points.range_m > 60.0 / np.cos(np.deg2rad(60.0))
    assert np.count_nonzero(ends) > 30
    assert abs(points.position_m[ends, 2].mean()) < 0.15


def test_likelihoods_are_those_of_plain_sums_over_the_whole_window():
    """Whatever is left out for speed: cells without a chance, and taps in which shapes do not differ."""
    end = replace(through(25.0)[2].end, ground=unknown_ground())
    rng, pulses = np.random.default_rng(4), 6
    power = rng.exponential(np.ones((pulses, end.cells)) * end.volume.background)
    power[:, 180:190] *= [[1.0], [2.0], [10.0], [100.0], [1e4], [1e6]]
    power[:, 190:] = rng.exponential(np.ones((pulses, end.cells - 190)) * end.volume.noise)
    drift_m, strength = np.full(pulses, 1.1), np.ones(pulses)
    views = Views(down=np.full(pulses, 0.7), shift_m=np.zeros(pulses), drift_m=drift_m, strength=strength)
    ratio = end.over_volume(power, strength)
    rows, columns, terms = next(iter(end._terms(ratio, views)))
    half = end._half
    padded = np.pad(ratio, ((0, 0), (half, half)), constant_values=1.0)
    padded[:, -half:] = 0.0
    silence, behind_silence = end._noise_fraction(0), end._silence(0)
    spans = list(_spans(behind_silence, end._columns, half))
    for column in (60, *range(140, 240, 7), columns[-1]):
        middle = next(span[len(span) // 2] for span in spans if column in span)
        near = silence[np.clip(middle + np.arange(-half, half + 1), 0, end.cells - 1)]
        ground = end._ground * (1 - near)
        ground /= ground.sum(axis=1, keepdims=True)
        mean = end._air(end._step(1.1)) * (1 - near) + near + end.ground.level[:, None, None] * ground
        inside = np.arange(-half, half + 1) + column < end.cells
        around = padded[:, None, None, column : column + 2 * half + 1]
        plain = -(np.log(mean) * inside + around * (1 / mean - 1)).sum(axis=3)
        behind = np.arange(end.cells) > column + half
        loss = -np.log(behind_silence) - ratio * (1 / behind_silence - 1)
        plain += np.maximum(loss, -LARGEST_LOSS)[:, behind].sum(axis=1)[:, None, None]
        # Rounding in float32, of the powers that add up to it.
        rounding = 2e-3 + 1e-5 * np.abs(plain) + 1e-7 * around.sum(axis=3)
        assert np.all(np.abs(terms[:, column - columns[0]] / end.looks - plain) < rounding)
    chances = end._candidates(ratio, views)
    peak = terms.max(axis=(2, 3))
    assert np.all(chances[rows] | (peak < peak.max(axis=1, keepdims=True) - NEGLIGIBLE))
    assert chances.mean() < 0.5
    for _, some, of_some in end._terms(ratio, views, chances):
        np.testing.assert_allclose(of_some, terms[:, np.isin(columns, some)], rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize("number", [2, 4])
@pytest.mark.parametrize("tilt", [0.0, 0.1])
def test_widths_of_echoes_are_those_of_drawn_slopes(number, tilt):
    """Slopes and curvatures drawn from normal distributions, tails included."""
    end = through(25.0)[2].end
    slope_weight = np.eye(len(SLOPES))[[number]]
    down, column = 0.72, 220
    range_cells = np.array([[column - 0.4 / end.cell_m]])
    got = end._prior.of(np.array([down]), range_cells, slope_weight, tilt)[0, 0, 0]
    rng = np.random.default_rng(5)
    incidence = np.arccos(down) - tilt - np.arctan(SLOPES[number] * rng.standard_normal(200_000))
    width = (column - 0.4 / end.cell_m) * beam_sigma(end.beam) * np.hypot(np.tan(np.clip(incidence, -1.5, 1.5)), 0.15)
    width = np.clip(width * np.exp(end.width_spread_nepers * rng.standard_normal(200_000)), *end.widths[[0, -1]])
    step = np.log(width / end.widths[0]) / np.log(end.widths[1] / end.widths[0])
    weight = np.maximum(np.cos(incidence), 0.0)
    drawn = [weight @ np.maximum(1 - np.abs(step - place), 0.0) for place in range(len(end.widths))]
    np.testing.assert_allclose(got, drawn / weight.sum(), atol=0.012)
    assert got.sum() == pytest.approx(1.0, abs=1e-5)
    # Slopes of hardly any weight are left out, and their weight is not that of the widest echoes.
    weight_of = 0.9 * MIN_SLOPE_WEIGHT + (1 - 0.9 * MIN_SLOPE_WEIGHT * len(SLOPES)) * slope_weight
    nearly = end._prior.of(np.array([down]), range_cells, weight_of, tilt)[0, 0, 0]
    np.testing.assert_allclose(nearly, got, atol=1e-6)


def test_a_hillside_in_rain_is_where_it_is():
    """Ground that climbs by 0.3 along the scan lines is 0.055 m too high here where slopes come from widths alone."""
    flight = {"weather.rain_rate_mm_per_h": 10.0, "platform.length_m": 20.0}
    survey = run(load_scenario("jacksboro", flight | LINEAR))
    assert abs(survey.lit_error.mean_m) < 0.045
    assert survey.dem_uncertainty.cells.coverage["95"] > 0.92
