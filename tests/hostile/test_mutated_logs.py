"""Logs of all kinds, damaged in a hundred ways: each ends in one error with a place, or in a flight that is one."""

import struct
import time
from pathlib import Path

import numpy as np
import pytest

from flight_logs import HEIGHT, WRITERS, flown, here, regular, ulog_bytes, ulog_topics
from mutants import mutated
from sionna_radar.flight.build import plan_route
from sionna_radar.foundation.errors import InputFileError, RadarError
from sionna_radar.readers.logs.reader import read_log
from sionna_radar.scenario.platform import Platform

MUTANTS = 21  # of each of five kinds
LONGEST_MESSAGE = 2000


def fly(path: Path) -> np.ndarray:
    platform = Platform(log=path)
    flight = plan_route(platform, here).fly(lambda point_m: np.zeros(len(point_m)), 1, HEIGHT)
    time_s = np.linspace(0.0, flight.trajectory.end_s, 200)
    trajectory = flight.trajectory
    return np.column_stack([trajectory.position(time_s), trajectory.velocity(time_s), trajectory.euler(time_s)])


@pytest.mark.parametrize("kind", WRITERS)
def test_a_damaged_log_ends_in_one_error_or_a_flight(kind, tmp_path, capfd):
    name, write = WRITERS[kind]
    path = write(tmp_path / name, flown(regular(10.0, 4.0)))
    content, rng = path.read_bytes(), np.random.default_rng([12, *kind.encode()])
    messages = []
    for _ in range(MUTANTS):
        path.write_bytes(mutated(content, rng))
        begun = time.process_time()
        try:
            assert np.isfinite(fly(path)).all()
        except RadarError as error:
            messages.append(str(error))
        assert time.process_time() - begun < 5.0  # hangs, not speed
    assert messages
    assert all(len(message) < LONGEST_MESSAGE and "platform.log" in message for message in messages)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    "declared",
    [
        b"vehicle_attitude:uint64_t timestamp;float[1000000000] q;",
        b"vehicle_attitude:uint64_t timestamp;vehicle_attitude again;",
    ],
)
def test_a_ulog_of_endless_fields_is_refused_before_they_are_named(declared, tmp_path):
    flight = flown(regular(10.0, 4.0))
    content = ulog_bytes({key: ulog_topics(flight)[key] for key in ("vehicle_local_position",)})
    head = 16 + 3 + 40
    bad = struct.pack("<HB", len(declared), ord("F")) + declared
    bad += struct.pack("<HB", 3 + 16, ord("A")) + struct.pack("<BH", 0, 9) + b"vehicle_attitude"
    path = tmp_path / "flight.ulg"
    path.write_bytes(content[:head] + bad + content[head:])
    with pytest.raises(InputFileError, match=r"array of .* elements|cannot be read as a ULog"):
        read_log(path)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", r"is none of the known logs"),
        (b"\x89PNG\r\n", r"is none of the known logs"),
        (b"ULog", r"cannot be read as a ULog"),
        (b"\xa3\x95", r"holds no message of a DataFlash log"),
        (bytes(8) + b"\xfe\x00", r"holds no MAVLink position"),
        (b"<?xml version='1.0'?>" + b"<a>" * 20_000, r"is not GPX"),
        (b"time_s," + b"9" * 200_000, r"line 1 has 200,007 characters|no header"),
    ],
    ids=["empty", "picture", "ulog", "dataflash", "telemetry", "deep xml", "long line"],
)
def test_what_is_no_log_is_said_to_be_none(content, said, tmp_path):
    path = tmp_path / "flight"
    path.write_bytes(content)
    with pytest.raises(InputFileError, match=said):
        read_log(path)


def test_no_folder_pipe_or_missing_file_is_read(tmp_path):
    for path in (tmp_path, tmp_path / "none.ulg", Path("/dev/zero")):
        with pytest.raises(InputFileError, match=r"give a log of a flight"):
            read_log(path)
