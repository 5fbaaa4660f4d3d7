"""Frames of an array as files: netCDF, and the raw layout of a capture card with its configuration."""

import os
from pathlib import Path

import h5py
import numpy as np
import pytest

from sionna_radar import load_scenario, prepare, run
from sionna_radar.foundation.errors import OutputError, ScenarioError
from sionna_radar.survey.recordings.capture_file import CubeRecorder, raw_counts, read_frames
from sionna_radar.survey.recordings.described import capture_config

FLIGHT = {
    "sensor": "mimo",
    "radar": {"preset": "ti_awr1843_array", "array": {"chirps": 16}},
    "terrain": {"kind": "flat", "size_m": [200.0, 200.0]},
    "targets": [{"position_m": [-99.5, 4.0], "height_m": 6.0, "rcs_dbsm": 25.0}],
    "platform.altitude_m": 20.0,
    "platform.length_m": 2.0,
    "tracing.paths_per_pulse": 500,
}


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cubes")
    surveys = [run(load_scenario("hills", FLIGHT), recordings={"cube": folder / name}) for name in ("a.bin", "a.nc")]
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
    frames = read_frames(folder / "a.bin", folder / "a.cfg")
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
    frame = read_frames(folder / "a.bin", folder / "a.cfg")[0].reshape(16, 3, 4, 256)
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


def test_netcdf_holds_the_same_frames_and_the_array(flown):
    folder, survey = flown
    with h5py.File(folder / "a.nc") as file:
        beat = file["in_phase"][:] + 1j * file["quadrature"][:]
        assert beat.shape == (2, 48, 4, 256)
        assert file["transmitter_place"][:] == pytest.approx(survey.prepared.module.transmitter_m)
        assert file["code_real"][:].tolist() == np.eye(3).tolist()
        assert file["measured_position"].shape == (2, 3)
    frames = read_frames(folder / "a.bin", folder / "a.cfg")
    assert abs(np.corrcoef(beat.ravel(), frames.ravel())[0, 1]) > 0.99


def test_numbers_of_a_capture_alternate_by_pairs():
    frame = (np.arange(4) + 10j * np.arange(4)).reshape(1, 1, 4)
    assert raw_counts(frame).tolist() == [0, 1, 0, 10, 2, 3, 20, 30]
    assert raw_counts(frame.real).tolist() == [0, 1, 2, 3]


def test_files_are_neither_overwritten_nor_of_another_sensor(flown, tmp_path):
    folder, _ = flown
    (tmp_path / "b.cfg").write_text("mine")
    with pytest.raises(OutputError, match=r"b\.cfg exists already"):
        run(load_scenario("hills", FLIGHT), recordings={"cube": tmp_path / "b.bin"})
    with pytest.raises(OutputError, match=r"a\.bin exists already"):
        run(load_scenario("hills", FLIGHT), recordings={"cube": folder / "a.bin"})
    with pytest.raises(ScenarioError, match="'signals' is of single chirps"):
        run(load_scenario("hills", FLIGHT), recordings={"signals": tmp_path / "c.nc"})
    with pytest.raises(ScenarioError, match="'cube' is of sensor = 'mimo'"):
        run(load_scenario("hills", {"platform.length_m": 2.0}), recordings={"cube": tmp_path / "c.nc"})
    assert (tmp_path / "b.cfg").read_text() == "mine"


def test_too_strong_an_echo_is_refused(tmp_path):
    prepared = prepare(load_scenario("hills", FLIGHT))
    recorder = CubeRecorder(tmp_path / "d.bin", prepared)
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
    assert np.array_equal(read_frames(tmp_path / "real.bin", tmp_path / "real.cfg")[0], frame)
