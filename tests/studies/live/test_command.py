"""The command `live`: replays, recordings of messages, and words for what does not go together."""

import json
from threading import Thread

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sionna_radar.foundation.raster import Raster
from sionna_radar.scenario import load_scenario
from sionna_radar.survey.chain import run

SHORT = ("--set", "platform.length_m=10", "--set", "tracing.paths_per_pulse=64")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    path = tmp_path_factory.mktemp("recorded") / "flight.nc"
    survey = run(
        load_scenario("hills", {"platform.length_m": 10.0, "tracing.paths_per_pulse": 64}), recordings={"signals": path}
    )
    return path, survey


def test_a_scenario_is_replayed_to_the_map_of_its_survey(cli, tmp_path, recorded):
    said = cli("live", "hills", *SHORT, "-o", tmp_path / "live")
    _, survey = recorded
    dem = Raster.read(tmp_path / "live" / "dem.tif")
    np.testing.assert_array_equal(dem.height_m, survey.dem.height_m.astype(np.float32))
    np.testing.assert_array_equal(
        Raster.read(tmp_path / "live" / "dem_sigma.tif").height_m, survey.dem_sigma.height_m.astype(np.float32)
    )
    numbers = json.loads((tmp_path / "live" / "live.json").read_text())
    assert (numbers["pulses"], numbers["echoes"]) == (survey.pulses, len(survey.points))
    assert numbers["lag_s"] is None
    assert numbers["messages"] == {}
    assert f"{survey.pulses:,} pulses" in said.stdout


def test_a_recording_is_replayed_to_the_same_map(cli, tmp_path, recorded):
    path, survey = recorded
    cli("live", path, "-o", tmp_path / "live", "--speed", 1000)
    dem = Raster.read(tmp_path / "live" / "dem.tif")
    np.testing.assert_array_equal(dem.height_m, survey.dem.height_m.astype(np.float32))
    assert set(json.loads((tmp_path / "live" / "live.json").read_text())["lag_s"]) == {"median", "95 %", "most"}


ERRORS = {
    "platform.navigation.position_constant_m": [2.0, 3.0, 1.0],
    "platform.navigation.attitude_constant_deg": [1.0, -2.0, 5.0],
    "platform.navigation.boresight_error_deg": [0.0, 0.5, 0.0],
    "platform.navigation.lever_arm_m": [0.5, 0.2, 0.1],
}


@pytest.mark.parametrize(
    "errors", [{}, ERRORS, ERRORS | {"radar.scan.mode": "conical", "radar.scan.incidence_deg": 30}]
)
def test_frames_of_the_vehicle_and_the_beam_are_those_of_the_points(cli, tmp_path, errors):
    """The last reading, along the axis of the beam from the chain of frames, ends at the last point."""
    reader = pytest.importorskip("mcap.reader")
    decoder = pytest.importorskip("mcap_ros2.decoder")
    changed = [f"--set={key}={value}" for key, value in errors.items()]
    cli("live", "hills", *SHORT, *changed, "-o", tmp_path / "live", "--mcap", tmp_path / "a.mcap")
    found = {}
    with (tmp_path / "a.mcap").open("rb") as file:
        messages = reader.make_reader(file, decoder_factories=[decoder.DecoderFactory()]).iter_decoded_messages()
        for _, channel, message, content in messages:
            found[channel.topic] = content
            assert message.log_time == message.publish_time
    in_map, in_body = found["/tf"].transforms
    assert (in_map.header.frame_id, in_map.child_frame_id) == ("map", "base_link")
    assert (in_body.header.frame_id, in_body.child_frame_id) == ("base_link", found["/radar/range"].header.frame_id)
    cloud = np.frombuffer(bytes(found["/radar/points"].data), "<f4").reshape(-1, 6)
    place_m = np.array([found["/radar/range"].range, 0.0, 0.0])
    for one in (in_body.transform, in_map.transform):
        q, t = one.rotation, one.translation
        place_m = Rotation.from_quat([q.x, q.y, q.z, q.w]).apply(place_m) + np.array([t.x, t.y, t.z])
    np.testing.assert_allclose(place_m, cloud[-1, :3], atol=1e-4)
    # Nose to the east, so left is north: turned by the reported heading, clockwise, only.
    heading_rad = np.deg2rad(5.0 if errors else 0.0)
    R = Rotation.from_quat([getattr(in_map.transform.rotation, axis) for axis in "xyzw"]).as_matrix()
    assert R[:2, 0] == pytest.approx([np.cos(heading_rad), -np.sin(heading_rad)], abs=2e-3)
    assert R[2, 2] > 0.99
    arm = in_body.transform.translation
    assert (arm.x, arm.y, arm.z) == pytest.approx((0.5, -0.2, -0.1) if errors else (0.0, 0.0, 0.0))


@pytest.mark.parametrize(("length_m", "flown_s"), [(3.0, 0.3), (15.0, 1.5)])
def test_the_time_flown_is_that_of_the_pulses_however_long_a_step_is(cli, tmp_path, length_m, flown_s):
    """At 10 m/s; a scan line of 25 pulses is 0.07 s at 360 Hz, and the last one ends before the flight does."""
    short = ("--set", f"platform.length_m={length_m}", "--set", "tracing.paths_per_pulse=64")
    cli("live", "hills", *short, "-o", tmp_path / "live")
    numbers = json.loads((tmp_path / "live" / "live.json").read_text())
    survey = run(load_scenario("hills", {"platform.length_m": length_m, "tracing.paths_per_pulse": 64}))
    assert numbers["flown_s"] == pytest.approx(np.ptp(survey.schedule.time_s), abs=1e-9)
    start_s, stop_s = survey.schedule.trajectory.cruise_s()
    assert stop_s - start_s == pytest.approx(flown_s)


def test_messages_are_read_back_by_rosbags(cli, tmp_path, recorded):
    highlevel = pytest.importorskip("rosbags.highlevel")
    pytest.importorskip("mcap_ros2")
    _, survey = recorded
    cli("live", "hills", *SHORT, "-o", tmp_path / "live", "--rosbag", tmp_path / "bag", "--mcap", tmp_path / "one.mcap")
    with highlevel.AnyReader([tmp_path / "bag"]) as reader:
        kinds = {connection.topic: connection.msgtype for connection in reader.connections}
        messages = {topic: [] for topic in kinds}
        for connection, stamp_ns, raw in reader.messages():
            messages[connection.topic].append((stamp_ns, reader.deserialize(raw, connection.msgtype)))
    assert kinds == {
        "/radar/points": "sensor_msgs/msg/PointCloud2",
        "/radar/range": "sensor_msgs/msg/Range",
        "/tf": "tf2_msgs/msg/TFMessage",
        "/radar/dem": "grid_map_msgs/msg/GridMap",
    }
    rows = np.concatenate(
        [np.frombuffer(cloud.data.tobytes(), "<f4").reshape(cloud.width, 6) for _, cloud in messages["/radar/points"]]
    )
    np.testing.assert_array_equal(rows[:, :3], survey.points.position_m.astype("<f4"))
    np.testing.assert_array_equal(rows[:, 4], survey.points.echo_snr_db.astype("<f4"))
    cloud = messages["/radar/points"][0][1]
    assert [field.name for field in cloud.fields] == ["x", "y", "z", "range_rate", "snr", "sigma"]
    # 10 m/s toward ground 45 deg ahead.
    assert np.all((rows[:, 3] < 0) & (rows[:, 3] > -10.0))
    stamp_ns, moved = messages["/tf"][-1]
    place = moved.transforms[0].transform
    pose = survey.prepared.flight.pulses(np.array([survey.pulses - 1])).true
    np.testing.assert_allclose(
        [place.translation.x, place.translation.y, place.translation.z], pose.position_m[0], atol=1e-9
    )
    assert abs(stamp_ns / 1e9 - survey.prepared.flight.time_s[-1]) < 1e-8
    # Nose to the east, left to the north: no turn at all.
    assert abs(place.rotation.w) == pytest.approx(1.0)
    _, grid = messages["/radar/dem"][0]
    rows_of_map, columns = survey.dem.grid.shape
    layer = np.array(grid.data[0].data).reshape(rows_of_map, columns)[::-1, ::-1]
    np.testing.assert_array_equal(layer.astype(np.float32), survey.dem.height_m.astype(np.float32))
    assert (tmp_path / "one.mcap").stat().st_size > 1000


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("hills", "--mavlink", "udp:nowhere"), "--mavlink: 'udp:nowhere' cannot be opened"),
        (("hills", "--mavlink", "udp:127.0.0.1:14550", "--speed", "2"), "--speed: has no meaning with --mavlink"),
        (("hills", "--mavlink", "there.mcap"), "--mavlink: 'there.mcap' cannot be opened (neither an address in a"),
        (("hills", "--seconds", "5"), "--seconds: has a meaning with --mavlink only"),
        (("hills", "--silence", "5"), "--silence: has a meaning with --mavlink only"),
        (("hills", "--system", "1"), "--system: has a meaning with --mavlink only"),
        (("hills", "--origin", "1,2,3"), "--origin: has a meaning with --mavlink only"),
        (("hills", "--clearance", "6"), "--clearance: has a meaning with --mavlink only"),
        (("hills", "--origin", "1,2"), "--origin: '1,2' are not three numbers"),
        (("hills", "--origin", "nan,0,0"), "--origin: 'nan,0,0' are not finite"),
        (("hills", "--mcap", "there.mcap"), "there.mcap: File exists; name a new one"),
        (("hills", "--rosbag", "bag"), "bag: File exists; name a new one"),
        (("hills", "--mcap", "new.mcap", "--rosbag", "bag"), "bag: File exists; name a new one"),
        (("no_such_scene",), "no_such_scene"),
        (("nothing.nc",), "nothing.nc"),
    ],
)
def test_what_cannot_be_is_one_error_and_nothing_is_written(cli, tmp_path, monkeypatch, arguments, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.mcap").write_text("mine")
    (tmp_path / "bag").mkdir()
    done = cli("live", *arguments, *(SHORT if arguments[0] == "hills" else ()), code=2)
    assert said in done.stderr
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["bag", "there.mcap"]
    assert (tmp_path / "there.mcap").read_text() == "mine"


def test_a_live_map_of_refined_navigation_is_said_to_be_of_reported_poses(cli, tmp_path):
    said = cli("live", "hills", *SHORT, "--set", "processing.navigation=refined", "-o", tmp_path / "live").stderr
    assert "the live map is of reported poses" in " ".join(said.split())


def test_a_recording_is_not_flown_by_an_autopilot(cli, recorded):
    done = cli("live", recorded[0], "--mavlink", "udp:127.0.0.1:14550", code=2)
    assert "--mavlink: needs a scenario" in done.stderr


def test_an_autopilot_flies_until_it_is_silent(cli, tmp_path):
    """Its faults are in `live.json`, and its readings came back."""
    from test_mavlink import BOOT_S, Peer, free_port

    port = free_port()
    came = []

    def fly():
        peer = Peer(port)
        # It is told when the radar listens by its first heartbeat; until then it stands still and says so.
        for wait in range(600):
            peer.odometry(BOOT_S + 0.05 * wait, (0.0, -100.0, -60.0))
            if peer.link.recv_match(type="HEARTBEAT", blocking=True, timeout=0.1) is not None:
                break
        for step in range(30):
            at_s = BOOT_S + 0.05 * (wait + 1 + step)
            peer.odometry(at_s, (0.0, -100.0 + 0.5 * step, -60.0))
            if step == 10:
                peer.odometry(at_s, (0.0, -95.0, -60.0))
            # Poses that come together are one step, with one answer.
            came.extend(peer.answers("OBSTACLE_DISTANCE", within_s=20.0) if step % 10 == 9 else [])
        peer.close()

    pilot = Thread(target=fly)
    pilot.start()
    try:
        cli(
            "live", "hills", *SHORT, "-o", tmp_path / "live", "--mavlink", f"udp:127.0.0.1:{port}", "--silence", 3,
        )  # fmt: skip
    finally:
        pilot.join()
    numbers = json.loads((tmp_path / "live" / "live.json").read_text())
    assert numbers["messages"]["doubled"] == 1
    assert numbers["pulses"] > 100
    assert numbers["lag_s"]["median"] > 0
    assert 3 <= len(came) <= numbers["messages"]["OBSTACLE_DISTANCE"]
    assert (tmp_path / "live" / "dem.tif").exists()
