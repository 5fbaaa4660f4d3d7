"""Frames of an array as files: netCDF, and the raw layout of a capture card with its configuration."""

import os
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from modules import CHIRP, line_of
from sionna_radar import load_scenario, prepare, process, run
from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.errors import InputFileError, OutputError, ScenarioError
from sionna_radar.readers.captures.capture_file import capture_config, open_capture, raw_counts, receiver_samples
from sionna_radar.readers.recordings.description import open_described
from sionna_radar.signal.array_beats import FramePaths, array_beats
from sionna_radar.studies.calibration.study import calibrate as run_calibration
from sionna_radar.studies.twin.study import twin as run_twin
from sionna_radar.survey.recordings.signal_recorder import SignalRecorder

FLIGHT = {
    "sensor": "mimo",
    "radar": {"preset": "ti_awr1843_array", "array": {"chirps": 16}},
    "terrain": {"kind": "flat", "size_m": [200.0, 200.0]},
    "targets": [{"position_m": [-99.5, 4.0], "height_m": 6.0, "rcs_dbsm": 25.0}],
    "platform.altitude_m": 20.0,
    "platform.length_m": 2.0,
    "tracing.paths_per_pulse": 500,
}


def read_frames(samples):
    """Return all frames of a raw capture, in counts."""
    capture = open_capture(samples)
    return capture.samples(np.arange(capture.shape[0]))


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cubes")
    surveys = [run(load_scenario("hills", FLIGHT), recordings={"cube": folder / name}) for name in ("a.bin", "b.nc")]
    return folder, surveys[0]


def openradar(raw, chirps, receivers, samples):
    """OpenRadar's `dca1000.organize`, from its description: I, I, Q, Q of two samples at a time."""
    raw = raw.reshape(-1, 4)
    out = np.empty(2 * len(raw), dtype=complex)
    out[0::2] = raw[:, 0] + 1j * raw[:, 2]
    out[1::2] = raw[:, 1] + 1j * raw[:, 3]
    return out.reshape(chirps, receivers, samples)


def test_a_capture_is_read_as_others_read_it(flown):
    folder, survey = flown
    raw = np.fromfile(folder / "a.bin", dtype="<i2").reshape(survey.pulses, -1)
    frames = read_frames(folder / "a.bin")
    assert frames.shape == (2, 48, 4, 256)
    for frame, values in zip(frames, raw, strict=True):
        assert np.array_equal(frame, openradar(values, 48, 4, 256))
    prepared = prepare(load_scenario("hills", FLIGHT))
    expected = prepared.observe(np.array([0, 1])).frames
    scale = np.vdot(frames, expected) / np.vdot(frames, frames)
    assert np.abs(frames * scale.real - expected).max() < 0.75 * scale.real * np.sqrt(2)


def test_an_open_chain_finds_the_target(flown):
    """Range, Doppler and angle by plain transforms of one virtual line, as range-Doppler toolboxes do it."""
    folder, survey = flown
    frame = read_frames(folder / "a.bin")[0].reshape(16, 3, 4, 256)
    # The first and the third transmitter and the receivers make eight elements half a wavelength apart.
    line = np.concatenate([frame[:, 0], frame[:, 2]], axis=1)
    window = np.hanning(256) * np.hanning(16)[:, None, None]
    cube = np.fft.fft(np.fft.fft(line * window, axis=2), axis=0)
    rate, cell = np.unravel_index(np.argmax(np.sum(np.abs(cube) ** 2, axis=1)), (16, 256))
    config = capture_config(folder / "a.cfg")
    cell_m = 299792458.0 / (2 * config.slope_mhz_us * 1e12 * config.samples / (1e3 * config.rate_ksps))
    pose = survey.prepared.flight.pulses(np.array([0])).true
    away = np.array([-99.5, 4.0, 6.0]) - pose.position_m[0]
    assert cell * cell_m == pytest.approx(np.linalg.norm(away), abs=cell_m)
    # Two chirps pass between both transmitters: their motion turns the second half.
    turn = np.exp(-2j * np.pi * np.fft.fftfreq(16)[rate] * 2 / 3)
    channels = cube[rate, :, cell] * np.repeat([1.0, turn], 4)
    spectrum = np.abs(np.fft.fft(channels.conj(), 256))
    left = np.fft.fftfreq(256)[np.argmax(spectrum)] * 2
    assert left == pytest.approx(4.0 / np.linalg.norm(away), abs=0.04)


@pytest.mark.filterwarnings("ignore::SyntaxWarning", "ignore::PendingDeprecationWarning")
def test_openradar_finds_the_target(flown, monkeypatch):
    """Where it is installed (https://github.com/PreSenseRadar/OpenRadar) it reads, transforms and steers itself.

    Two of its functions fail today: one calls `np.complex`, and the compensation of motion slices by a float.
    """
    dsp, loader = (pytest.importorskip(f"mmwave.{part}") for part in ("dsp", "dataloader"))
    monkeypatch.setattr(np, "complex", complex, raising=False)
    folder, survey = flown
    config, pulses = capture_config(folder / "a.cfg"), np.arange(2)
    cell_m, _ = dsp.range_resolution(config.samples, config.rate_ksps, config.slope_mhz_us)
    pose, found = survey.prepared.flight.pulses(pulses).true, survey.prepared.observe(pulses).echoes
    for pulse, raw in enumerate(np.fromfile(folder / "a.bin", dtype=np.int16).reshape(2, -1)):
        cube = dsp.range_processing(loader.DCA1000.organize(raw, 48, 4, 256), dsp.Window.HANNING)
        power, channels = dsp.doppler_processing(cube, num_tx_antennas=3, window_type_2d=dsp.Window.HANNING)
        cell, rate = np.unravel_index(np.argmax(power), power.shape)
        turn = np.exp(-2j * np.pi * np.fft.fftfreq(16)[rate] * np.arange(3) / 3)
        eight = (channels[cell, :, rate].reshape(3, 4) * turn[:, None])[[0, 2]].ravel()
        bartlett = dsp.aoa_bartlett(dsp.gen_steering_vec(90, 1, 8)[1], eight[:, None], axis=0)
        # Of the first transmitter alone, which needs no compensation.
        capon, _ = dsp.aoa_capon(cube[::3, :, cell].T, dsp.gen_steering_vec(90, 1, 4)[1], magnitude=True)
        ours = found.of_pulses(np.array([pulse]))
        best = np.argmax(ours.power)
        away = np.array([-99.5, 4.0, 6.0]) - pose.position_m[pulse]
        range_m, left_deg = np.linalg.norm(away), np.rad2deg(np.arcsin(4.0 / np.linalg.norm(away)))
        assert [cell * cell_m, ours.range_m[best]] == pytest.approx([range_m, range_m], abs=0.5 * cell_m)
        lefts = [np.argmax(bartlett) - 90, np.argmax(capon) - 90, np.rad2deg(np.arcsin(ours.direction[best, 1]))]
        assert lefts == pytest.approx([left_deg] * 3, abs=1.0)


def test_netcdf_holds_the_same_frames_and_the_array(flown):
    folder, survey = flown
    with h5py.File(folder / "b.nc") as file:
        beat = file["beat_i"][:] + 1j * file["beat_q"][:]
        assert beat.shape == (2, 48, 4, 256)
        assert file["transmitter_place"][:] == pytest.approx(survey.prepared.instrument.module.transmitter_m)
        assert file["code_real"][:].tolist() == np.eye(3).tolist()
        assert file["measured_position"].shape == (2, 3)
    frames = read_frames(folder / "a.bin")
    assert abs(np.corrcoef(beat.ravel(), frames.ravel())[0, 1]) > 0.99


def test_recorded_frames_make_the_same_points_and_map(flown):
    """From netCDF bit for bit; from a capture as far as its counts, of a seventh of the noise, let them."""
    folder, survey = flown
    again = process(folder / "b.nc")
    assert again.points.sha256() == survey.points.sha256()
    np.testing.assert_array_equal(again.dem.height_m, survey.dem.height_m)
    np.testing.assert_array_equal(again.comparison.truth.height_m, survey.truth.height_m)
    rounded = process(folder / "a.bin")
    apart = np.linalg.norm(rounded.points.position_m[:, None] - survey.points.position_m, axis=2).min(axis=1)
    assert len(rounded.points) == pytest.approx(len(survey.points), rel=0.1)
    stated = np.median(np.hypot(survey.points.range_sigma_m, survey.points.across_sigma_m))
    assert 0 < np.median(apart) < 0.2 * stated


def test_processing_of_frames_has_settings_and_needs_their_array(flown, tmp_path):
    folder, survey = flown
    some = process(folder / "b.nc", {"processing.min_range_m": 20.5})
    assert len(some.points) > 0
    assert some.points.range_m.min() > 20.0 > survey.points.range_m.min()
    card = f'recording = {{ samples = "{folder}/a.bin", config = "{folder}/a.cfg" }}\n'
    (tmp_path / "card.toml").write_text(card)
    assert process(tmp_path / "card.toml").points is None
    elements = {"transmitters_wavelengths": [[0, 0], [1, 0.5], [2, 0]], "receivers_wavelengths": [[0, 0], [0.5, 0]]}
    for place, said in (("card.toml", "single chirps"), ("b.nc", "cannot be changed for a recording")):
        with pytest.raises(ScenarioError, match=said):
            process((tmp_path if place == "card.toml" else folder) / place, {"radar.array": elements})
    keys = "\n".join(f"{key} = {value}" for key, value in elements.items())
    (tmp_path / "few.toml").write_text(f"{card}[radar.array]\n{keys}\nchirps = 16\n")
    with pytest.raises(ScenarioError, match="frames of 48 chirps of 4 receivers; change it"):
        process(tmp_path / "few.toml")


@pytest.mark.parametrize("real", [False, True])
def test_the_measured_response_of_channels_is_divided_out(flown, tmp_path, real):
    folder, _ = flown
    frames, config = read_frames(folder / "a.bin"), capture_config(folder / "a.cfg")
    rng = np.random.default_rng(8)
    gain_db, phase_deg = rng.uniform(-3, 3, (3, 4)), rng.uniform(-180, 180, (3, 4))
    response = 10 ** (gain_db / 20) * np.exp(1j * np.deg2rad(phase_deg))
    uneven = frames * np.tile(response, (16, 1))[..., None]
    rate_hz = 1e3 * config.rate_ksps
    array = f"""sweep.carrier_hz = 77e9
sweep.bandwidth_hz = {1e12 * config.slope_mhz_us * config.samples / rate_hz}
sweep.sampling_rate_hz = {rate_hz}
sweep.pulse_rate_hz = 8000.0
[radar.array]
transmitters_wavelengths = [[0.0, 0.0], [1.0, 0.5], [2.0, 0.0]]
receivers_wavelengths = [[0.0, 0.0], [0.5, 0.0], [1.0, 0.0], [1.5, 0.0]]
chirps = 16
"""
    rows = f"channel_gain_db = {gain_db.tolist()}\nchannel_phase_deg = {phase_deg.tolist()}\n"
    found = {}
    for name, samples, corrected in (("even", frames, ""), ("uneven", uneven, ""), ("corrected", uneven, rows)):
        np.save(tmp_path / f"{name}.npy", (np.real if real else np.asarray)(samples).reshape(-1, *samples.shape[2:]))
        recording = f'[recording]\nsamples = "{name}.npy"\naxes = ["pulse", "receiver", "sample"]\n{corrected}'
        (tmp_path / f"{name}.toml").write_text("\n".join(reversed((recording, array))))
        with open_described(tmp_path / f"{name}.toml") as signals:
            found[name] = signals.beats(flown[1].prepared.flight.pulses(np.arange(2)))[0]
    # The analytic signal of real samples takes the noise of negative beats for that of positive ones.
    wrong = [np.std(found[name] - found["even"]) / np.std(found["even"]) for name in ("uneven", "corrected")]
    assert wrong[0] > 1
    assert wrong[1] < (0.08 if real else 1e-12)


def test_responses_of_channels_that_do_not_fit_are_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.ones((48, 4, 64), dtype=complex))
    recording = 'samples = "a.npy"\naxes = ["pulse", "receiver", "sample"]'
    sweep = "carrier_hz = 77e9\nbandwidth_hz = 1e9\nsampling_rate_hz = 5e6\npulse_rate_hz = 8000.0"
    element = (
        "transmitters_wavelengths = [[0, 0], [2, 0]]\nreceivers_wavelengths = [[0, 0], [0.5, 0], [1, 0], [1.5, 0]]"
    )
    array = f"[radar.array]\nchirps = 24\n{element}"
    for rows, described, said in (
        ("[[1.0, 0.0, 0.0]]", array, r"has rows of \[3\]; give 4 receivers in one row, or in each of 2 rows"),
        ("[[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]]", array, r"has rows of \[4, 4, 4\]"),
        ("[[0, 0, 0, 0], [0, 0, 0, 0]]", f'{array}\nmultiplexing = "bpm"', "give 4 receivers in one row$"),
        ("[[1.0, 0.0, 0.0, 0.0]]", "", "applies to the channels of an array; describe it in"),
    ):
        (tmp_path / "a.toml").write_text(
            f"[recording]\n{recording}\nchannel_gain_db = {rows}\n[sweep]\n{sweep}\n{described}"
        )
        with pytest.raises(ScenarioError, match=said):
            process(tmp_path / "a.toml")


def test_frames_are_neither_compared_nor_calibrated_as_single_echoes(flown):
    folder, _ = flown
    with pytest.raises(ScenarioError, match="'mimo' has no beat signals to compare"):
        run_twin(folder / "b.nc")
    with pytest.raises(ScenarioError, match="or of an array has no whole echoes"):
        run_calibration([folder / "b.nc"])


def test_a_capture_that_is_not_whole_is_refused(flown, tmp_path):
    folder, _ = flown
    for name in ("a.nc", "a.cfg"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    with pytest.raises(InputFileError, match=r"a\.bin"):
        process(tmp_path / "a.bin")
    (tmp_path / "a.bin").write_bytes((folder / "a.bin").read_bytes()[:-4])
    with pytest.raises(InputFileError, match="get the whole file"):
        process(tmp_path / "a.bin")
    # A frame less is whole, and not all that was flown.
    (tmp_path / "a.bin").write_bytes((folder / "a.bin").read_bytes()[: 48 * 4 * 256 * 4])
    with pytest.raises(InputFileError, match=r"has the shape \(2,\), not \(1,\)"):
        process(tmp_path / "a.bin")


@pytest.mark.parametrize("lanes", [2, 4])
@pytest.mark.parametrize("complex_samples", [True, False])
def test_all_receivers_of_a_capture_are_those_of_each(lanes, complex_samples, flown):
    folder, _ = flown
    config = replace(capture_config(folder / "a.cfg"), receivers=3, samples=8, complex_samples=complex_samples)
    raw = np.arange(2 * 5 * 3 * 8 * (2 if complex_samples else 1)).reshape(2, 5, -1)
    every = receiver_samples(raw, config, lanes)
    assert every.shape == (2, 5, 3, 8)
    for receiver in range(3):
        np.testing.assert_array_equal(every[:, :, receiver], receiver_samples(raw, config, lanes, receiver))
    assert len(np.unique(every)) == every.size


def test_frames_of_another_radar_give_directions_without_poses(tmp_path):
    """Two targets of a still module, of which one goes away: their ranges and directions in the module's plane."""
    array, chirps = line_of(1, 4, blocks=32), 32
    place, rate = np.array([[6.0, 2.0, 0.0], [8.0, -3.0, 0.0]]), np.array([0.0, 1.5])
    range_m = np.linalg.norm(place, axis=1)
    paths = FramePaths(place_m=place, beyond_m=np.zeros(2), drift_mps=rate, gain=np.ones(2, dtype=complex))
    zero = np.zeros((chirps, 3))
    still = Pose(position_m=zero, velocity_mps=zero, R_world_antenna=np.tile(np.eye(3), (chirps, 1, 1)))
    beats = array_beats(paths, still, array, CHIRP)
    noise = np.random.default_rng(1).normal(scale=0.03, size=(*beats.shape, 2))
    np.save(tmp_path / "frame.npy", beats + noise[..., 0] + 1j * noise[..., 1])
    left = (array.receiver_m[:, 1] / array.wavelength_m).tolist()
    (tmp_path / "frame.toml").write_text(
        f"""
        recording = {{ samples = "frame.npy", axes = ["pulse", "receiver", "sample"] }}
        processing = {{ cfar = {{ guard = 4, training = 8 }}, min_range_m = 3.0 }}
        [sweep]
        carrier_hz = 77e9
        bandwidth_hz = 400e6
        sampling_rate_hz = {CHIRP.sampling_rate_hz}
        pulse_rate_hz = 16e3
        [radar.array]
        transmitters_wavelengths = [[0, 0]]
        receivers_wavelengths = {[[x, 0.0] for x in left]}
        chirps = 32
        """
    )
    found = process(tmp_path / "frame.toml")
    echoes = found.echoes
    assert found.points is None
    for target, cosine in enumerate(place[:, 1] / range_m):
        near = np.abs(echoes.range_m - range_m[target]) < 0.4
        strongest = np.flatnonzero(near)[np.argmax(echoes.power[near])]
        assert abs(echoes.direction[strongest, 1] - cosine) < 0.02


def test_numbers_of_a_capture_alternate_by_pairs():
    frame = (np.arange(4) + 10j * np.arange(4)).reshape(1, 1, 4)
    assert raw_counts(frame).tolist() == [0, 1, 0, 10, 2, 3, 20, 30]
    assert raw_counts(frame.real).tolist() == [0, 1, 2, 3]


def test_files_are_neither_overwritten_nor_of_another_sensor(flown, tmp_path):
    folder, _ = flown
    (tmp_path / "b.cfg").write_text("mine")
    (tmp_path / "e.nc").write_text("mine")
    for name, taken in (("b.bin", r"b\.cfg"), ("e.bin", r"e\.nc")):
        with pytest.raises(OutputError, match=f"{taken} exists already"):
            run(load_scenario("hills", FLIGHT), recordings={"cube": tmp_path / name})
    with pytest.raises(OutputError, match=r"a\.bin exists already"):
        run(load_scenario("hills", FLIGHT), recordings={"cube": folder / "a.bin"})
    with pytest.raises(ScenarioError, match="'signals' is of single chirps"):
        run(load_scenario("hills", FLIGHT), recordings={"signals": tmp_path / "c.nc"})
    with pytest.raises(ScenarioError, match="'cube' is of sensor = 'mimo'"):
        run(load_scenario("hills", {"platform.length_m": 2.0}), recordings={"cube": tmp_path / "c.nc"})
    assert (tmp_path / "b.cfg").read_text() == "mine"


def test_too_strong_an_echo_is_refused(tmp_path):
    prepared = prepare(load_scenario("hills", FLIGHT))
    recorder = SignalRecorder(tmp_path / "d.bin", prepared)
    pulses = prepared.flight.pulses(np.array([0]))
    seen = prepared.observe(np.array([0]))
    seen.frames[:] *= 1e6
    with pytest.raises(OutputError, match="16 bits hold 32767; record netCDF"):
        recorder.write(pulses, seen)
    recorder.close()


REAL = Path(os.environ.get("SIONNA_RADAR_RECORDINGS") or Path(__file__).parents[2].parent / "shared" / "data")


@pytest.mark.skipif(not (REAL / "ti_77ghz_frame_4rx.npz").exists(), reason="real frames are not here")
def test_real_frames_pass_through_a_capture(tmp_path):
    """Samples of a real module, written and read as they were."""
    with np.load(REAL / "ti_77ghz_frame_4rx.npz") as file:
        iq = file["iq"].astype(float)
    frame = iq[..., 0] + 1j * iq[..., 1]
    raw_counts(frame).astype("<i2").tofile(tmp_path / "real.bin")
    (tmp_path / "real.cfg").write_text(
        "channelCfg 15 1 0\nadcCfg 2 1\nprofileCfg 0 77 7 6 60 0 0 60 1 128 2500 0 0 30\nchirpCfg 0 0 0 0 0 0 0 1\n"
        f"frameCfg 0 0 {len(frame)} 1 100 1 0\n"
    )
    assert np.array_equal(read_frames(tmp_path / "real.bin")[0], frame)
    (tmp_path / "real.toml").write_text(
        """
        recording = { samples = "real.bin", config = "real.cfg" }
        processing = { cfar = { guard = 6, training = 20 }, min_range_m = 2.0 }
        [radar.array]
        transmitters_wavelengths = [[0, 0]]
        receivers_wavelengths = [[0, 0], [0.5, 0], [1.0, 0], [1.5, 0]]
        chirps = 128
        """
    )
    echoes = process(tmp_path / "real.toml").echoes
    # The strongest by plain transforms: a standing object, and one that moves.
    for range_m, left_deg in ((5.2, -1.8), (2.93, -6.2)):
        near = np.flatnonzero(np.abs(echoes.range_m - range_m) < 0.1)
        strongest = near[np.argmax(echoes.power[near])]
        assert np.rad2deg(np.arcsin(echoes.direction[strongest, 1])) == pytest.approx(left_deg, abs=1.5)
