"""Raw captures as they come: stopped by hand, of short chirps, without a description."""

from pathlib import Path

import numpy as np
import pytest
from scipy.constants import speed_of_light

from sionna_radar import process
from sionna_radar.detection.build import build_detector
from sionna_radar.foundation.errors import InputFileError
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scenario import load_scenario
from sionna_radar.scenario.processing import CfarTable, ProcessingTable

SLOPE, RATE_HZ, LOOPS, RECEIVERS = 30e12, 4e6, 6, 2
RANGE_M = 7.5


def config(samples: int, frames: int, tx: str = "1") -> str:
    return (
        f"channelCfg 3 7 0\nadcCfg 2 1\nprofileCfg 0 76.5 5 4 50 0 0 30 1 {samples} 4000 0 0 30\n"
        f"chirpCfg 0 0 0 0 0 0 0 {tx}\nframeCfg 0 0 {LOOPS} {frames} 40 1 0\n"
    )


def capture(folder: Path, samples: int, frames: float, stated: int, tx: str = "1") -> Path:
    """Write a capture of one target that ends within a frame, and its configuration."""
    rng = np.random.default_rng(4)
    shape = (int(np.ceil(frames)), LOOPS, RECEIVERS, samples)
    beat = 3000 * np.exp(2j * np.pi * 2 * SLOPE * RANGE_M / speed_of_light * np.arange(samples) / RATE_HZ)
    beat = beat + 20 * (rng.normal(size=shape) + 1j * rng.normal(size=shape))
    pairs = beat.reshape(*shape[:-1], -1, 1, 2)
    raw = np.rint(np.concatenate([pairs.real, pairs.imag], axis=-2)).astype("<i2").ravel()
    raw[: int(frames * raw.size / shape[0])].tofile(folder / "adc.bin")
    (folder / "chirps.cfg").write_text(config(samples, stated, tx))
    return folder / "adc.bin"


def described(folder: Path) -> Path:
    path = folder / "d.toml"
    path.write_text('[recording]\nsamples = "adc.bin"\nconfig = "chirps.cfg"\n[processing]\nmin_range_m = 1.0\n')
    return path


@pytest.mark.parametrize(("frames", "stated", "words"), [
    (4.25, 0, "4 whole frames are read, and the 4,608 bytes after them (25% of a frame) are left out"),
    (3.5, 9, "3 whole frames are read, of the 9 that its configuration states, and the 9,216 bytes after them"),
    (3.0, 9, "3 whole frames are read, of the 9 that its configuration states; the capture was stopped"),
    (3.0, 3, None),
])  # fmt: skip
def test_a_capture_that_ends_within_a_frame_is_read_to_its_last_whole_frame(tmp_path, frames, stated, words):
    samples = 384
    capture(tmp_path, samples, frames, stated)
    found = process(described(tmp_path))
    assert len(found.time_s) == int(frames) * LOOPS
    assert abs(np.median(found.echoes.range_m) - RANGE_M) < 0.01
    said = [warning for warning in found.warnings if "frame" in warning]
    assert (words in said[0]) if words else not said


def test_less_than_a_frame_is_refused(tmp_path):
    capture(tmp_path, 128, 0.9, 0)
    with pytest.raises(InputFileError, match="less than the 6,144 of one frame"):
        process(described(tmp_path))


@pytest.mark.parametrize("samples", [48, 80, 112, 160])
def test_short_chirps_are_detected_without_settings(tmp_path, samples):
    capture(tmp_path, samples, 2.0, 2)
    found = process(described(tmp_path))
    assert len(found.echoes) == 2 * LOOPS
    # The centroid of a line, within a tenth of a range cell.
    assert abs(np.median(found.echoes.range_m) - RANGE_M) < 0.1 * speed_of_light / (2 * SLOPE * samples / RATE_HZ)


def test_guard_and_training_follow_from_the_range_cells():
    usual, room = CfarTable(), range(3, 400)
    assert usual.sides(161) == usual.sides(10_000) == (48, 32)
    assert all(usual.misfit(cells) is None for cells in room)
    # As many as fit: one more on each side would not.
    assert all(2 * (sum(usual.sides(cells)) + 1) >= min(cells, 162) for cells in room)
    assert all(training >= 1 for _, training in map(usual.sides, room))
    # What is given stays.
    assert CfarTable(guard=10).sides(64) == (10, 21)
    assert CfarTable(training=10).sides(64) == (21, 10)
    assert CfarTable(guard=10).sides(1000) == (10, 32)
    assert "guard + training = 41 cells on each side do not fit 64 range cells" in CfarTable(guard=40).misfit(64)
    assert CfarTable(guard=40, training=30).sides(64) == (40, 30)


@pytest.mark.parametrize(("samples", "sampling"), [(56, "iq"), (100, "iq"), (130, "real")])
def test_short_spectra_keep_the_false_alarm_rate(samples, sampling):
    chirp = Chirp(carrier_hz=77e9, bandwidth_hz=1e9, rate_hz=1e4, samples=samples, sampling=sampling)
    probability = 1e-2
    processing = ProcessingTable(cfar={"false_alarm_probability": probability}, zero_padding=1)
    detector = build_detector(processing, chirp)
    rng = np.random.default_rng(7)
    beat = rng.normal(size=(4000, samples)) + (1j * rng.normal(size=(4000, samples)) if sampling == "iq" else 0.0)
    spectra = detector.spectra(beat)
    # Cells that share noise by the window: as if a third of them were independent.
    cells = slice(3, -3)
    found = np.mean(spectra.power[:, cells] > spectra.threshold[:, cells])
    count = spectra.power[:, cells].size / 3
    assert abs(found - probability) < 5 * np.sqrt(probability / count)


def test_a_scenario_of_short_chirps_needs_no_settings_either():
    scenario = load_scenario("hills", {"radar.samples_per_chirp": 128})
    assert scenario.processing.cfar.sides(64) == (18, 13)
    again = load_scenario("hills").replace({"radar.samples_per_chirp": 128})
    assert again.processing.cfar == scenario.processing.cfar


@pytest.mark.parametrize("samples", [32, 96, 512])
def test_a_description_is_written_on_request_and_processed(cli, tmp_path, monkeypatch, samples):
    monkeypatch.chdir(tmp_path)
    capture(tmp_path, samples, 2.0, 2, tx="4")
    refused = cli("process", "adc.bin", code=2)
    assert "adc.bin is a raw capture, and needs a description" in refused.stderr
    assert "process adc.bin --describe profile.cfg" in refused.stderr
    said = cli("process", "adc.bin", "--describe", "chirps.cfg").stdout
    assert "assumed: 2 LVDS lanes" in said
    assert "receiver 1 of 2 and transmitter 3 (of 3)" in said
    assert "process it with: sionna-radar process adc.toml" in said
    written = (tmp_path / "adc.toml").read_text()
    cli("process", "adc.toml", "-o", "out", "--no-report")
    found = process(tmp_path / "adc.toml")
    assert abs(np.median(found.echoes.range_m) - RANGE_M) < 0.1 * speed_of_light / (2 * SLOPE * samples / RATE_HZ)
    # Nothing is overwritten, and another place names its files from there.
    assert "exists already" in cli("process", "adc.bin", "--describe", "chirps.cfg", code=2).stderr
    assert (tmp_path / "adc.toml").read_text() == written
    (tmp_path / "far").mkdir()
    cli("process", "adc.bin", "--describe", "chirps.cfg", "-o", "far/mine.toml")
    assert len(process(tmp_path / "far" / "mine.toml").echoes) == len(found.echoes)


@pytest.mark.parametrize(("name", "options", "words"), [
    ("adc.bin", [], "nowhere.cfg does not exist"),
    ("other.npy", [], "is not a raw capture"),
    ("nothing.bin", [], "does not exist"),
    ("adc.bin", ["--set", "dem.method=smooth"], "--describe: takes no --set"),
])  # fmt: skip
def test_what_cannot_be_described_is_one_error(cli, tmp_path, monkeypatch, name, options, words):
    monkeypatch.chdir(tmp_path)
    capture(tmp_path, 64, 1.0, 1)
    config = "nowhere.cfg" if words.startswith("nowhere") else "chirps.cfg"
    assert words in cli("process", name, "--describe", config, *options, code=2).stderr
    assert not list(tmp_path.glob("*.toml"))
