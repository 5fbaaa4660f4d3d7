"""Logs of every kind hold the flight that was written into them: places, velocities and attitudes in one frame."""

import struct
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from flight_logs import (
    HEIGHT,
    LAT,
    LON,
    WRITERS,
    csv_columns,
    csv_text,
    dataflash_bytes,
    dataflash_messages,
    flown,
    here,
    regular,
    telemetry_bytes,
    ulog_bytes,
    ulog_topics,
    write_csv,
)
from sionna_radar.elevation.local_frame import frame_at
from sionna_radar.flight.log import in_metres, running_rms
from sionna_radar.foundation.errors import InputFileError
from sionna_radar.readers.logs.reader import read_log

FLIGHT = flown(regular())
UP = np.array([0.0, 0.0, HEIGHT])
# To which a format keeps metres, m/s and radians: float32 in ULog, 1e-7 deg, hundredths of a degree or of m/s. North
# is that of the flight's middle, 1e-5 rad from that of the frame 40 m beside it.
KEPT = {
    "csv": (1e-3, 1e-4, 1e-5),
    "gpx": (1e-3, None, None),
    "ulog": (1e-3, 1e-4, 1e-5),
    "dataflash": (0.01, 1e-4, 2e-4),
    "telemetry": (0.01, 0.008, 1e-5),
}


@pytest.mark.parametrize("kind", WRITERS)
def test_a_log_holds_the_flight_that_was_written(kind, tmp_path):
    name, write = WRITERS[kind]
    log = read_log(write(tmp_path / name, FLIGHT))
    metric = in_metres(log, here())
    place_m, velocity_mps, turn_rad = KEPT[kind]
    np.testing.assert_allclose(metric.positions.time_s, FLIGHT.time_s, atol=1e-5)
    np.testing.assert_allclose(metric.positions.place, FLIGHT.place + UP, atol=place_m)
    assert (metric.positions.velocity_mps is None) == (velocity_mps is None)
    if velocity_mps is not None:
        np.testing.assert_allclose(metric.positions.velocity_mps, FLIGHT.velocity, atol=velocity_mps)
    assert (metric.attitudes is None) == (turn_rad is None)
    if turn_rad is not None:
        apart = Rotation.from_quat(metric.attitudes.quaternion).inv() * Rotation.from_quat(FLIGHT.quaternion)
        assert apart.magnitude().max() < 2 * turn_rad


@pytest.mark.parametrize("kind", ["csv", "ulog", "telemetry"])
def test_on_a_map_headings_and_velocities_turn_to_grid_north(kind, tmp_path):
    """At 47.4 N and 0.46 deg from its UTM zone's middle, grid north is 0.34 deg off; the scale is 0.9996."""
    name, write = WRITERS[kind]
    frame = frame_at(LON, LAT)
    metric = in_metres(read_log(write(tmp_path / name, FLIGHT)), frame)
    convergence = np.deg2rad(frame.georeference().convergence_deg)
    assert abs(np.rad2deg(convergence)) > 0.3
    euler = Rotation.from_quat(metric.attitudes.quaternion).as_euler("ZYX")
    off = np.mod(FLIGHT.euler[:, 2] - euler[:, 0] + np.pi, 2 * np.pi) - np.pi
    np.testing.assert_allclose(off, convergence, atol=2e-5)
    # What moves along the grid is what the places say: their differences, at a rate high against the curvature.
    place, velocity = metric.positions.place, metric.positions.velocity_mps
    differences = (place[2:] - place[:-2]) / (metric.positions.time_s[2:] - metric.positions.time_s[:-2])[:, None]
    bias = np.mean(differences - velocity[1:-1], axis=0)
    np.testing.assert_allclose(bias[:2], 0.0, atol=2e-3)


def test_csv_in_metres_is_taken_as_it_is(tmp_path):
    for attitude in ("euler", "quaternion"):
        log = read_log(write_csv(tmp_path / "a.csv", FLIGHT, attitude=attitude))
        metric = in_metres(log, here())
        assert not log.on_map
        np.testing.assert_allclose(metric.positions.place, FLIGHT.place, atol=1e-8)
        apart = Rotation.from_quat(metric.attitudes.quaternion).inv() * Rotation.from_quat(FLIGHT.quaternion)
        assert apart.magnitude().max() < 1e-7


def test_streams_of_different_rates_share_a_csv(tmp_path):
    columns = csv_columns(FLIGHT)
    columns["east_m"] = np.where(np.arange(len(FLIGHT.time_s)) % 4 == 0, columns["east_m"], np.nan)
    columns |= {key: np.where(np.isnan(columns["east_m"]), np.nan, columns[key]) for key in ("north_m", "up_m")}
    path = tmp_path / "a.csv"
    path.write_text(csv_text(columns | {"sigma_east_m": 0.1 + 0 * FLIGHT.time_s, "battery": FLIGHT.time_s}))
    with pytest.raises(InputFileError, match=r"sigma_north_m, sigma_up_m"):
        read_log(path)
    path.write_text(csv_text(columns | {"battery": FLIGHT.time_s}))
    log = read_log(path)
    assert (len(log.positions.time_s), len(log.attitudes.time_s)) == (101, 401)
    assert "battery" in log.notes[0]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("time_s,east_m,north_m\n0,1,2\n", r"line 1 'time_s,east_m,north_m': unrecognised CSV header; give time_s"),
        ("time_s,east_m,north_m,up_m\n0,0,0,1\n1,2,oops,1\n", r"line 3: north_m = 'oops' is no number"),
        ("time_s,east_m,north_m,up_m\n0,0,0\n", r"line 2 has 3 cells and the header 4"),
        ("time_s,east_m,north_m,up_m,qw\n0,0,0,1,1\n", r"add qx, qy, qz"),
        ("time_s,east_m,north_m,up_m,up_m\n0,0,0,1,1\n", r"up_m twice"),
        ("time_s,east_m,north_m,up_m\n", r"has 0 positions"),
    ],
)
def test_a_bad_csv_is_refused_with_its_line(text, said, tmp_path):
    path = tmp_path / "flight.csv"
    path.write_text(text)
    with pytest.raises(InputFileError, match=said):
        read_log(path, "platform.log")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('<!DOCTYPE a [<!ENTITY b "c">]><gpx>&b;</gpx>', r"declares entities or a document type"),
        ("<gpx><trk>", r"is not GPX"),
        ('<gpx version="1.1" creator="x"><wpt lat="1" lon="2"/></gpx>', r"holds 0 points of a track"),
        (
            '<gpx version="1.1" creator="x"><trk><trkseg><trkpt lat="1" lon="2"><ele>1</ele></trkpt>'
            '<trkpt lat="1" lon="2"><ele>1</ele></trkpt></trkseg></trk></gpx>',
            r"point 1 of the track has no time",
        ),
    ],
)
def test_a_bad_gpx_is_refused(text, said, tmp_path):
    path = tmp_path / "flight.gpx"
    path.write_text(text)
    with pytest.raises(InputFileError, match=said):
        read_log(path)


def test_a_missing_package_is_named_with_its_extra(tmp_path, monkeypatch):
    path = WRITERS["gpx"][1](tmp_path / "flight.gpx", FLIGHT)
    monkeypatch.setattr("sionna_radar.readers.logs.reader.find_spec", lambda name: None)
    with pytest.raises(InputFileError, match=r"needs gpxpy; install it: pip install 'sionna_radar\[logs\]'"):
        read_log(path)


def test_a_reset_of_the_filter_s_position_leaves_no_jump(tmp_path):
    """After a reset x, y and z are larger by what the log says; before it they were that much too small."""
    topics = ulog_topics(FLIGHT)
    local = topics["vehicle_local_position"]
    late = FLIGHT.time_s >= 8.0
    steps = {"x": ("xy_reset_counter", "delta_xy[0]", 7.0), "y": ("xy_reset_counter", "delta_xy[1]", -4.0)}
    steps["z"] = ("z_reset_counter", "delta_z", 2.0)
    for axis, (counter, delta, size) in steps.items():
        local[axis] = ("float", local[axis][1] - size * ~late)
        local[counter] = ("uint8_t", late.astype(float))
        local[delta] = ("float", size * late)
    path = tmp_path / "flight.ulg"
    path.write_bytes(ulog_bytes(topics))
    log = read_log(path)
    np.testing.assert_allclose(in_metres(log, here()).positions.place, FLIGHT.place + UP, atol=1e-3)
    assert log.notes == ("1 resets of the filter's position: what came before each is moved by it",)


def test_a_damaged_ulog_is_refused_in_words(tmp_path, monkeypatch):
    path = tmp_path / "flight.ulg"
    path.write_bytes(ulog_bytes(ulog_topics(FLIGHT)))
    monkeypatch.setattr("sionna_radar.readers.logs.ulog.MAX_READINGS", 0)
    monkeypatch.setattr("sionna_radar.readers.logs.ulog.MAX_EXTRA", 100)
    with pytest.raises(InputFileError, match=r"as a ULog \(read over and over without an end\); give one of PX4"):
        read_log(path, "platform.log")


def test_a_ulog_without_a_reference_is_in_local_metres(tmp_path):
    topics = ulog_topics(FLIGHT)
    for key in ("ref_lat", "ref_lon", "ref_alt"):
        topics["vehicle_local_position"][key] = ("double", np.full(len(FLIGHT.time_s), np.nan))
    topics["vehicle_local_position"] |= {"x": ("float", FLIGHT.place[:, 1]), "y": ("float", FLIGHT.place[:, 0])}
    path = tmp_path / "flight.ulg"
    path.write_bytes(ulog_bytes(topics))
    log = read_log(path)
    assert (log.on_map, log.datum) == (False, "take-off")
    np.testing.assert_allclose(log.positions.place, FLIGHT.place, atol=2e-3)


def test_standard_deviations_of_a_filter_s_covariance(tmp_path):
    """24 states: a quaternion, velocity and position in north, east, down."""
    variance = np.array([1e-6, 2e-6, 3e-6, 6e-6, 0.04, 0.09, 0.16, 0.25, 0.36, 0.49, *[1.0] * 14])
    time_us = FLIGHT.time_s[::20] * 1e6 + 1e7
    status = {"timestamp": ("uint64_t", time_us)}
    status |= {f"covariances[{i}]": ("float", np.full(len(time_us), v)) for i, v in enumerate(variance)}
    status |= {"n_states": ("uint8_t", np.full(len(time_us), 24.0))}
    path = tmp_path / "flight.ulg"
    path.write_bytes(ulog_bytes(ulog_topics(FLIGHT) | {"estimator_status": status}))
    spreads = read_log(path).spreads
    np.testing.assert_allclose(spreads.position_m[0], [0.6, 0.5, 0.7], rtol=1e-6)
    np.testing.assert_allclose(spreads.velocity_mps[0], [0.3, 0.2, 0.4], rtol=1e-6)
    np.testing.assert_allclose(spreads.attitude_rad[0], np.sqrt(4 * 12e-6 / 3), rtol=1e-6)


def test_variances_of_a_quaternion_sum_to_a_quarter_of_those_of_the_turn():
    rng = np.random.default_rng(1)
    turn = Rotation.from_rotvec(rng.normal(0.0, 0.01, (20_000, 3))) * Rotation.from_euler("ZYX", [1.0, 0.3, -0.2])
    spread = np.var(turn.as_quat(), axis=0).sum()
    assert np.sqrt(4 * spread / 3) == pytest.approx(0.01, rel=0.02)


def test_spreads_of_the_other_formats(tmp_path):
    found = {kind: read_log(write(tmp_path / name, FLIGHT)).spreads for kind, (name, write) in WRITERS.items()}
    np.testing.assert_allclose(found["ulog"].position_m[3], [0.3, 0.3, 0.5], rtol=1e-6)
    np.testing.assert_allclose(found["dataflash"].position_m, 0.2, rtol=1e-6)  # innovations
    assert found["csv"] is None


def test_the_running_rms_is_that_of_the_values_in_its_span():
    rng = np.random.default_rng(2)
    time_s, value = np.sort(rng.uniform(0, 60, 300)), rng.normal(0, 2, (300, 3))
    value[5] = np.nan
    slow = [np.sqrt(np.nanmean(value[np.abs(time_s - t) <= 5.0] ** 2, axis=0)) for t in time_s]
    np.testing.assert_allclose(running_rms(time_s, value, 10.0), slow, rtol=1e-9)


def test_dataflash_is_read_as_pymavlink_reads_it(tmp_path, capfd):
    """The reader of ArduPilot's own project is the slow oracle; half floats, scaled and unused messages included."""
    from pymavlink.DFReader import DFReader_binary

    rng = np.random.default_rng(3)
    messages = dataflash_messages(FLIGHT)
    messages["MODE"] = ("QBI", {"TimeUS": FLIGHT.time_s[:3] * 1e6, "Mode": np.arange(3.0), "Rsn": rng.uniform(0, 9, 3)})
    path = tmp_path / "flight.bin"
    path.write_bytes(dataflash_bytes(messages))
    oracle = DFReader_binary(str(path))
    rows = []
    while (message := oracle.recv_match(type=["POS"])) is not None:
        rows.append([message.TimeUS * 1e-6, message.Lng, message.Lat, message.Alt])
    oracle.filehandle.close()
    oracle.data_map.close()
    capfd.readouterr()
    rows = np.array(rows)
    log = read_log(path)
    np.testing.assert_allclose(log.positions.time_s, rows[:, 0] - rows[0, 0], atol=1e-9)
    np.testing.assert_allclose(log.positions.place, rows[:, 1:], rtol=1e-12)


def test_a_message_of_no_length_does_not_hold_up_the_reader(tmp_path):
    content = dataflash_bytes(dataflash_messages(FLIGHT))
    endless = b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", 77, 0, b"LOOP", b"Q", b"TimeUS") + b"\xa3\x95" + bytes([77])
    path = tmp_path / "flight.bin"
    path.write_bytes(content[:89] + endless + content[89:])
    log = read_log(path)
    assert len(log.positions.time_s) == len(FLIGHT.time_s)
    assert "3 bytes between messages are damaged" in log.notes[0]


def test_old_dataflash_logs_count_milliseconds(tmp_path):
    """Before 2015: TimeMS, of the GPS the week's, whose column T is the autopilot's clock."""
    lon, lat, height = FLIGHT.degrees.T
    clock, zeros = FLIGHT.time_s * 1e3 + 4000, 0 * FLIGHT.time_s
    gps = {"Status": 3 + zeros, "TimeMS": clock + 1e8, "Lat": lat, "Lng": lon, "Alt": height, "T": clock}
    heading = np.mod(np.rad2deg(FLIGHT.euler[:, 2]), 360.0)
    attitude = {"TimeMS": clock, "Roll": np.rad2deg(FLIGHT.euler[:, 0]), "Pitch": zeros, "Yaw": heading}
    path = tmp_path / "flight.bin"
    path.write_bytes(dataflash_bytes({"GPS": ("BILLeI", gps), "ATT": ("IccC", attitude)}))
    log = read_log(path)
    np.testing.assert_allclose(log.positions.time_s, log.attitudes.time_s, atol=1e-9)


def test_a_vehicle_s_clock_that_begins_anew_is_set_to_the_station_s(tmp_path):
    early, late = flown(regular(10.0, 5.0)), flown(regular(10.0, 5.0) + 8.0)
    shifted = replace(late, time_s=late.time_s)
    path = tmp_path / "flight.tlog"
    # The second run counts from its own start: 4 s earlier than the first one ended.
    path.write_bytes(telemetry_bytes(early) + telemetry_bytes(shifted, start_ms=-8000))
    log = read_log(path)
    np.testing.assert_allclose(log.positions.time_s, np.concatenate([early.time_s, late.time_s]), atol=2e-3)
    assert "clock restarted (1 times)" in log.notes[0]
