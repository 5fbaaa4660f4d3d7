"""Chirp configurations with values that no capture has: one error each, at once."""

import json
import re
import tracemalloc

import numpy as np
import pytest

from hard_files import CONFIG, STUDIO, _capture
from mutants import mutated
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.readers.captures.capture_file import capture_config
from sionna_radar.survey.recording_source import open_recording

STUDIO_TEXT = json.dumps({"mmWaveDevices": [{"rfConfig": STUDIO}]})
MUTANTS = 150
# Larger than any value, no numbers, and as long as JSON lets them be.
EXTREME = [
    "1e999",
    "-1",
    "0",
    "87654321987",
    "inf",
    "nan",
    "1e-300",
    '"0xFFFFFFFFFFFFFFFFFF"',
    "[]",
    "9" * 4000,
    "1e300",
]


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("chirpCfg 0 0", "chirpCfg 1 87654321987", "chirps 1 to 87654321987; they ascend, and are 0 to 511"),
        ("frameCfg 0 0", "frameCfg 0 87654321987", "the frame is of chirps 0 to 87654321987"),
        ("frameCfg 0 0", "frameCfg 3 1", "the frame is of chirps 3 to 1; they ascend"),
        ("chirpCfg 0 0", "chirpCfg 4 2", "a definition is of chirps 4 to 2"),
        ("frameCfg 0 0", "frameCfg 0 1", "chirp 1 of the frame is not defined"),
        ("chirpCfg 0 0 0", "chirpCfg 0 0 3", "profile 3.0, which is not defined"),
        ("8 3 50", "8 inf 50", "infinity"),
        ("8 3 50", "8 3 0", "frame period (ms): 0.0 is not within"),
        ("8 3 50", "8 3 0.5", "frame period: 0.5 ms is shorter than the 0.536 ms of its chirps"),
        ("8 3 50", "0 3 50", "loops of a frame: 0 is not within"),
        ("8 3 50", "1e9 3 50", "loops of a frame: 1000000000 is not within"),
        ("0 77 7", "0 0 7", "start frequency (GHz): 0.0 is not within"),
        ("0 77 7", "0 77 -7", "idle time (us): -7.0 is not within"),
        ("0 0 60 1", "0 0 0 1", "size of the slope (MHz/us): 0.0 is not within"),
        ("1 64 5000", "1 64 nan", "sampling rate (ksps): nan is not within"),
        ("1 64 5000", "1 63 5000", "63 is odd"),
        ("1 64 5000", "1 9e15 5000", "samples of a chirp: 9000000000000000 is not within"),
        ("channelCfg 3", "channelCfg -3", "receivers: 0 is not within"),
        ("0 0 0 0 0 1", "0 0 0 0 0 0", "transmitters of the chirps"),
        ("adcCfg 2 1", "adcCfg 2", "adcCfg has 1 values, and at least 2 are needed"),
    ],
)
def test_a_cfg_that_no_radar_takes_is_refused(tmp_path, before, after, words):
    assert before in CONFIG
    (tmp_path / "a.cfg").write_text(CONFIG.replace(before, after, 1))
    with pytest.raises(InputFileError) as refused:
        capture_config(tmp_path / "a.cfg")
    assert words in str(refused.value)


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ('"chirpEndIdx": 0', '"chirpEndIdx": 87654321987', "chirps 0 to 87654321987"),
        ('"numFrames": 3', '"numFrames": 1e999', "infinity"),
        ('"numFrames": 3', '"numFrames": -1', "frames: -1 is not within"),
        ('"txEnable": "0x1"', f'"txEnable": "0x{"F" * 5000}"', "a mask of channels has more than 32 bits"),
        ('"profileId": 0, "start', f'"profileId": {"[" * 200_000}{"]" * 200_000}, "start', "nested too deeply"),
        ('"startFreqConst_GHz": 77.0', '"startFreqConst_GHz": 0.0', "start frequency (GHz): 0.0"),
        ('"framePeriodicity_msec": 50', '"framePeriodicity_msec": 0', "frame period (ms): 0.0"),
    ],
)
def test_a_json_that_no_radar_takes_is_refused(tmp_path, before, after, words):
    assert before in STUDIO_TEXT
    (tmp_path / "a.mmwave.json").write_text(STUDIO_TEXT.replace(before, after))
    with pytest.raises(InputFileError) as refused:
        capture_config(tmp_path / "a.mmwave.json")
    assert words in str(refused.value)


def test_thousands_of_definitions_take_neither_time_nor_memory(tmp_path):
    (tmp_path / "a.cfg").write_text(CONFIG + "chirpCfg 0 511 0 0 0 0 0 2\n" * 50_000)
    tracemalloc.start()
    config = capture_config(tmp_path / "a.cfg")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert config.transmitters == (2,)
    assert peak < 100e6


@pytest.mark.parametrize("name", ["a.cfg", "a.mmwave.json"])
def test_a_damaged_configuration_is_one_error_or_a_capture_in_order(tmp_path, name):
    whole = (CONFIG if name == "a.cfg" else STUDIO_TEXT).encode()
    numbers = list(re.finditer(rb"\d+\.?\d*", whole))
    (tmp_path / "adc.bin").write_bytes(_capture())
    toml = tmp_path / "d.toml"
    toml.write_text(f'[recording]\nsamples = "adc.bin"\nconfig = "{name}"\n[processing]\nmin_range_m = 0.01\n')
    generator, read = np.random.default_rng(19), 0
    for mutant in range(MUTANTS):
        at = numbers[generator.integers(len(numbers))]
        value = EXTREME[generator.integers(len(EXTREME))].encode()
        changed = whole[: at.start()] + value + whole[at.end() :]
        (tmp_path / name).write_bytes(changed if mutant % 2 else mutated(whole, generator))
        try:
            with open_recording(toml, {}) as source:
                assert (np.diff(source.file.time_s) > 0).all()
                assert source.sweeps[0].carrier_hz > 1e9
                read += 1
        except (InputFileError, ScenarioError):
            continue
    assert 0 < read < MUTANTS
