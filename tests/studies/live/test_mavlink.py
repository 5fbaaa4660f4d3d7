"""An autopilot's messages, good and bad, and what it is told; the peer is pymavlink's own end of a socket."""

import os
import socket
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.scenario import load_scenario
from sionna_radar.studies.live.mavlink import CLOCK_STEP_S, MavlinkVehicle, sectors
from sionna_radar.studies.live.radar import Radar

os.environ.setdefault("MAVLINK20", "1")  # pymavlink reads it when it is imported
mavutil = pytest.importorskip("pymavlink.mavutil")

DOWN = {
    "platform.length_m": 20.0,
    "radar.scan.mode": "fixed",
    "radar.scan.incidence_deg": 0.0,
    "radar.chirp_rate_hz": 40.0,
    "tracing.paths_per_pulse": 64,
}
BOOT_S = 7000.0


class Clock:
    """Time that passes as told."""

    def __init__(self):
        self.now_s = 100.0

    def __call__(self):
        return self.now_s


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


class Peer:
    """The autopilot's end."""

    def __init__(self, port, system=1):
        self.port = port
        self.link = mavutil.mavlink_connection(
            f"udpout:127.0.0.1:{port}", source_system=system, dialect="ardupilotmega"
        )

    def close(self):
        self.link.close()

    def odometry(self, boot_s, ned_m, *, velocity=(0.0, 10.0, 0.0), roll=0.0, pitch=0.0, yaw=np.pi / 2, child=12):
        attitude = Rotation.from_euler("ZYX", [yaw, pitch, roll])
        q = [float(each) for each in attitude.as_quat()[[3, 0, 1, 2]]]
        body = attitude.inv().apply(velocity).tolist() if child == 12 else velocity
        self.link.mav.odometry_send(
            round(boot_s * 1e6), 1, child, *ned_m, q, *body, 0.0, 0.0, 0.0, [np.nan] * 21, [np.nan] * 21, 0, 0
        )

    def answers(self, kind, within_s=0.05):
        """Return the messages of a kind that have come, the first within a time."""
        first = self.link.recv_match(type=kind, blocking=True, timeout=within_s)
        found = [] if first is None else [first]
        while (message := self.link.recv_match(blocking=True, timeout=0.05)) is not None:
            found += [message] if message.get_type() == kind else []
        return found


@pytest.fixture(scope="module")
def altimeter():
    return load_scenario("hills", DOWN)


@pytest.fixture
def flown(altimeter):
    """A vehicle with its peer, and time that passes as told."""
    port, clock = free_port(), Clock()
    vehicle = MavlinkVehicle(f"udp:127.0.0.1:{port}", Radar(altimeter), clock=clock)
    peer = Peer(port)
    yield vehicle, peer, clock
    vehicle.close()
    peer.close()


def at(step, height_m=60.0):
    """North, east and down of the flight after so many steps of 50 ms."""
    return (0.0, -100.0 + 0.5 * step, -height_m)


def test_poses_come_as_they_were_sent(flown):
    vehicle, peer, _ = flown
    peer.odometry(BOOT_S, at(0))
    peer.odometry(BOOT_S + 0.05, at(1))
    peer.odometry(BOOT_S + 0.10, at(2), child=1)
    poses = vehicle.wait(1.0)
    np.testing.assert_allclose(poses.time_s - CLOCK_STEP_S, [0.0, 0.05, 0.1], atol=1e-6)
    np.testing.assert_allclose(poses.position_m, [[-100 + 0.5 * step, 0, 60] for step in range(3)], atol=1e-4)
    np.testing.assert_allclose(poses.velocity_mps, [[10.0, 0.0, 0.0]] * 3, atol=1e-5)
    np.testing.assert_allclose(poses.euler_rad, [[0.0, 0.0, np.pi / 2]] * 3, atol=1e-6)
    assert vehicle.wait(0.01) is None


def test_local_positions_wait_for_an_attitude(flown):
    vehicle, peer, _ = flown
    send = peer.link.mav
    send.local_position_ned_send(7_000_000, *at(0), 0.0, 10.0, 0.0)
    send.attitude_send(7_000_040, 0.0, 0.1, np.pi / 2, -0.2 * np.sin(0.1), 0.0, 0.2 * np.cos(0.1))
    send.local_position_ned_send(7_000_050, *at(1), 0.0, 10.0, 0.0)
    send.local_position_ned_send(7_000_400, *at(8), 0.0, 10.0, 0.0)  # the attitude is too old
    poses = vehicle.wait(1.0)
    np.testing.assert_allclose(poses.euler_rad, [[0.0, 0.1, np.pi / 2 + 0.002]], atol=1e-6)
    assert vehicle.counts["without an attitude"] == 2


def test_an_attitude_turns_about_the_axes_of_the_body_until_its_position(flown):
    """In a turn banked by 60 deg most of the turn rate is about the right wing, and pitch and roll stay."""
    vehicle, peer, _ = flown
    bank, yaw, yaw_rate = np.deg2rad(60.0), 0.4, -0.8
    peer.link.mav.attitude_send(7_000_000, bank, 0.0, yaw, 0.0, yaw_rate * np.sin(bank), yaw_rate * np.cos(bank))
    peer.link.mav.local_position_ned_send(7_000_150, *at(0), 0.0, 10.0, 0.0)
    poses = vehicle.wait(1.0)
    np.testing.assert_allclose(poses.euler_rad, [[bank, 0.0, yaw + 0.15 * yaw_rate]], atol=1e-6)


def test_of_several_kinds_of_positions_the_first_counts(flown):
    """ODOMETRY with a clock of its own beside the others; and the attitude of another vehicle is none of this one's."""
    vehicle, peer, clock = flown
    send, stranger = peer.link.mav, Peer(peer.port, system=9)
    for step in range(4):
        clock.now_s += 0.05
        peer.odometry(1.7e9 + 0.05 * step, at(step))
        send.attitude_send(7_000_000 + 50 * step, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        send.local_position_ned_send(7_000_000 + 50 * step, 500.0, 500.0, -60.0, 0.0, 0.0, 0.0)
        poses = vehicle.wait(1.0)
        np.testing.assert_allclose(poses.position_m, [[-100 + 0.5 * step, 0, 60]], atol=1e-4)
    assert vehicle.counts["beside another kind of position"] == 4
    assert vehicle.counts["clock set"] == vehicle.counts["late"] == 0
    clock.now_s += 5.0  # the odometry is lost
    stranger.link.mav.attitude_send(7_005_000, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    send.local_position_ned_send(7_005_000, *at(4), 0.0, 10.0, 0.0)
    send.attitude_send(7_005_050, 0.0, 0.0, np.pi / 2, 0.0, 0.0, 0.0)
    send.local_position_ned_send(7_005_050, *at(5), 0.0, 10.0, 0.0)
    poses = vehicle.wait(1.0)
    stranger.close()
    np.testing.assert_allclose(poses.euler_rad, [[0.0, 0.0, np.pi / 2]], atol=1e-6)


def test_global_positions_are_on_the_map():
    radar = Radar(load_scenario("jacksboro", {"platform.length_m": 50.0, "tracing.paths_per_pulse": 64}))
    place = radar.prepared.world.scene.georeference
    from pyproj import CRS, Transformer

    lon, lat = Transformer.from_crs(CRS.from_wkt(place.crs_wkt).to_2d(), 4326, always_xy=True).transform(
        place.origin_m[0] + 30.0, place.origin_m[1] - 40.0
    )
    port = free_port()
    vehicle, peer = MavlinkVehicle(f"udp:127.0.0.1:{port}", radar, clock=Clock()), Peer(port)
    north_deg = place.convergence_deg
    peer.link.mav.attitude_send(1000, 0.0, 0.0, np.deg2rad(90.0), 0.0, 0.0, 0.0)
    height_mm = round((place.origin_m[2] + 120.0) * 1000)
    peer.link.mav.global_position_int_send(1000, round(lat * 1e7), round(lon * 1e7), height_mm, 0, 0, 1500, 0, 9000)
    poses = vehicle.wait(1.0)
    vehicle.close()
    peer.close()
    np.testing.assert_allclose(poses.position_m, [[30.0, -40.0, 120.0]], atol=0.02)
    # East of true north is not quite east on the map.
    np.testing.assert_allclose(poses.euler_rad, [[0.0, 0.0, np.deg2rad(90.0 - north_deg)]], atol=1e-6)
    turned = np.deg2rad(90.0 - north_deg)
    np.testing.assert_allclose(poses.velocity_mps, [[15 * np.sin(turned), 15 * np.cos(turned), 0.0]], atol=1e-3)


def test_global_positions_over_a_place_unknown_are_counted(flown):
    vehicle, peer, _ = flown
    peer.link.mav.attitude_send(1000, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    peer.link.mav.global_position_int_send(1000, 0, 0, 0, 0, 0, 0, 0, 0)
    assert vehicle.wait(0.5) is None
    assert vehicle.counts["without a map"] == 1


def test_a_distance_is_the_height_with_its_covariance_and_time(flown, altimeter):
    vehicle, peer, _ = flown
    frame = None
    for step in range(12):
        peer.odometry(BOOT_S + 0.05 * step, at(step))
        poses = vehicle.wait(1.0)
        frame = vehicle._radar.step(poses.time_s, poses.position_m, poses.euler_rad, poses.velocity_mps)
        vehicle.send(frame)
    sent = peer.answers("DISTANCE_SENSOR")
    assert len(sent) >= 10
    last = sent[-1]
    ground_m = vehicle._radar.prepared.world.ground_m(frame.pulses.true.position_m[-1:, :2])[0]
    assert last.current_distance == pytest.approx((60.0 - ground_m) * 100, abs=50)
    assert (last.orientation, last.type, last.signal_quality) == (25, 3, 100)
    assert last.covariance == np.ceil((frame.echoes.range_sigma_m[-1] * 100) ** 2)
    # Not older than it says, and by less than a millisecond of its clock.
    pulse_boot_s = BOOT_S + frame.pulses.time_s[-1] - CLOCK_STEP_S
    assert 0 <= pulse_boot_s * 1000 - last.time_boot_ms < 1.001
    heartbeats = vehicle.counts["DISTANCE_SENSOR"]
    assert heartbeats == len(sent)


def flown_frame(vehicle, peer, boot_s=BOOT_S, height_m=60.0):
    """Return the frame of a step of 50 ms, as it was sent."""
    for step in range(2):
        peer.odometry(boot_s + 0.05 * step, at(step, height_m))
        poses = vehicle.wait(1.0)
        frame = vehicle._radar.step(poses.time_s, poses.position_m, poses.euler_rad, poses.velocity_mps)
    return frame


def test_a_variance_is_rounded_up_and_unknown_beyond_a_byte(flown):
    """16 cm have a variance of 256 cm2; 254 would state less than that."""
    vehicle, peer, _ = flown
    frame = flown_frame(vehicle, peer)
    for sigma_m, variance_cm2 in ((0.001, 1), (0.0505, 26), (0.159, 253), (0.16, 255), (2.0, 255)):
        sigmas = np.full(len(frame.echoes), sigma_m)
        vehicle.send(replace(frame, echoes=replace(frame.echoes, range_sigma_m=sigmas)))
        assert peer.answers("DISTANCE_SENSOR")[-1].covariance == variance_cm2


def test_a_distance_beyond_what_a_message_holds_is_marked_invalid(flown):
    """655.33 m at most: a height of 900 m must not be told as 655 m of good quality."""
    vehicle, peer, _ = flown
    frame = flown_frame(vehicle, peer)
    beyond = replace(frame, echoes=replace(frame.echoes, range_m=frame.echoes.range_m + 840.0))
    vehicle.send(beyond)
    last = peer.answers("DISTANCE_SENSOR")[-1]
    assert (last.signal_quality, last.covariance, last.current_distance) == (1, 255, last.max_distance)


@pytest.mark.parametrize("epoch_s", [0.0, 7000.0, 1.7e9])
def test_obstacles_bear_the_time_of_the_peers_clock_also_from_1970(epoch_s):
    radar = Radar(load_scenario("hills", {"platform.length_m": 20.0, "tracing.paths_per_pulse": 64}))
    port = free_port()
    vehicle, peer = MavlinkVehicle(f"udp:127.0.0.1:{port}", radar, clock=Clock()), Peer(port)
    frame = flown_frame(vehicle, peer, epoch_s)
    vehicle.send(frame)
    message = peer.answers("OBSTACLE_DISTANCE")[-1]
    vehicle.close()
    peer.close()
    pulse_us = 1e6 * (epoch_s + frame.pulses.time_s[-1] - CLOCK_STEP_S)
    assert 0 <= pulse_us - message.time_usec < 2.0


@pytest.mark.parametrize("system", [1, 42])
def test_messages_bear_the_number_of_the_vehicle_and_not_of_a_ground_station(altimeter, system):
    """255 is the ground station's, whose heartbeat an autopilot's failsafe waits for."""
    for stated in (None, system):
        port = free_port()
        vehicle = MavlinkVehicle(f"udp:127.0.0.1:{port}", Radar(altimeter), system=stated, clock=Clock())
        peer = Peer(port, system)
        frame = flown_frame(vehicle, peer)
        vehicle.send(frame)
        sent = peer.answers("DISTANCE_SENSOR")
        vehicle.close()
        peer.close()
        assert {(message.get_srcSystem(), message.get_srcComponent()) for message in sent} == {(system, 196)}


def test_without_an_echo_a_distance_is_marked_invalid(altimeter):
    radar = Radar(load_scenario("hills", DOWN | {"radar.snr_db": -60.0}))
    port = free_port()
    vehicle, peer = MavlinkVehicle(f"udp:127.0.0.1:{port}", radar, clock=Clock()), Peer(port)
    for step in range(4):
        peer.odometry(BOOT_S + 0.05 * step, at(step))
        poses = vehicle.wait(1.0)
        vehicle.send(radar.step(poses.time_s, poses.position_m, poses.euler_rad, poses.velocity_mps))
    sent = peer.answers("DISTANCE_SENSOR")
    vehicle.close()
    peer.close()
    assert sent
    assert all(message.signal_quality == 1 for message in sent)
    assert all(message.current_distance == message.max_distance for message in sent)


def heard(vehicle, peer, *stamped):
    """Send poses of some steps at some times of the peer, and return the times at which the radar takes them."""
    for step, boot_s in stamped:
        peer.odometry(boot_s, at(step))
    poses = vehicle.wait(0.5)
    return [] if poses is None else np.round(poses.time_s - CLOCK_STEP_S, 4).tolist()


def test_faults_are_counted_and_nothing_stops(flown):
    vehicle, peer, clock = flown
    assert heard(vehicle, peer, (0, BOOT_S), (1, BOOT_S + 0.05)) == [0.0, 0.05]
    # Doubled, late, lost.
    assert heard(vehicle, peer, (1, BOOT_S + 0.05), (0, BOOT_S + 0.02), (4, BOOT_S + 0.2)) == [0.2]
    assert (vehicle.counts["doubled"], vehicle.counts["late"]) == (1, 1)
    # Of another system, in another frame, without numbers, not of MAVLink.
    stranger = Peer(peer.port, system=7)
    stranger.odometry(BOOT_S + 0.25, at(5))
    peer.link.mav.odometry_send(
        round((BOOT_S + 0.26) * 1e6),
        3,
        12,
        0,
        0,
        0,
        [1.0, 0, 0, 0],
        0,
        0,
        0,
        0,
        0,
        0,
        [np.nan] * 21,
        [np.nan] * 21,
        0,
        0,
    )
    peer.odometry(BOOT_S + 0.27, (np.nan, 0.0, -60.0))
    peer.link.port.sendto(b"\x00 nonsense", peer.link.destination_addr)
    assert heard(vehicle, peer, (6, BOOT_S + 0.3)) == [0.3]
    stranger.close()
    assert vehicle.counts["of another system"] == 1
    assert vehicle.counts["in another frame"] == 1
    assert vehicle.counts["without a usable pose"] == 2
    # The peer dies for a minute, and comes back with its clock.
    clock.now_s += 60.0
    assert heard(vehicle, peer, (7, BOOT_S + 60.3)) == [60.3]
    assert vehicle.counts["clock set"] == 0
    # It starts anew, and counts from zero; then its clock is set forward by an hour.
    clock.now_s += 2.0
    assert heard(vehicle, peer, (8, 0.0), (9, 0.05)) == [62.3, 62.35]
    clock.now_s += 0.05
    assert heard(vehicle, peer, (10, 3600.1)) == [62.4]
    assert vehicle.counts["clock set"] == 2
    assert heard(vehicle, peer, (11, 3600.15)) == [62.45]


def test_a_reading_after_the_clock_was_set_bears_the_new_time(flown):
    vehicle, peer, clock = flown
    for step, boot_s in ((0, BOOT_S), (1, BOOT_S + 0.05), (2, 5.0), (3, 5.05), (4, 5.1)):
        clock.now_s += 0.05
        peer.odometry(boot_s, at(step))
        poses = vehicle.wait(1.0)
        vehicle.send(vehicle._radar.step(poses.time_s, poses.position_m, poses.euler_rad, poses.velocity_mps))
    assert 5_050 <= peer.answers("DISTANCE_SENSOR")[-1].time_boot_ms <= 5_100


@pytest.mark.parametrize(
    "address",
    [
        *("udp:127.0.0.1", "udp:127.0.0.1:port", "udp:127.0.0.1:99999999", "udp:256.1.1.1:14550", "udpbcast:127.0.0.1"),
        *("127.0.0.1:14550", "flight.tlog", ".", "csv:flight.csv", __file__, "", os.devnull),
    ],
)
def test_an_address_that_cannot_be_opened_is_refused(altimeter, address):
    with pytest.raises(ScenarioError, match=r"--mavlink: .* cannot be opened"):
        MavlinkVehicle(address, Radar(altimeter))


def test_sectors_hold_the_nearest_obstacle_clockwise_from_the_nose():
    ahead, right, behind = (1.0, 0.0), (0.0, 1.0), (-1.0, 0.0)
    obstacles = np.array([[10.0, 0.2], [7.0, 0.0], [0.0, 30.0], [0.0, -5.0]])
    found = sectors(np.array([ahead, right, behind]), obstacles, 10_000)
    assert (found[0], found[18], found[36], found[54]) == (700, 3000, 10_001, 500)
    assert np.all(np.delete(found, [0, 18, 36, 54]) == 65535)
    assert found.dtype == np.uint16
    assert found.shape == (72,)


@pytest.mark.parametrize(
    ("roll_deg", "pitch_deg", "lever_arm_m"),
    [(0.0, 0.0, (0.0, 0.0, 0.0)), (40.0, 0.0, (0.0, 0.0, 0.0)), (-20.0, -30.0, (-6.0, 2.0, 1.0))],
)
def test_obstacles_are_what_lies_at_the_height_of_the_vehicle(roll_deg, pitch_deg, lever_arm_m):
    """A wall ahead of a scan that looks forward, and not the ground beneath: level sectors, however it banks."""
    keys = {
        "platform.length_m": 20.0,
        "platform.altitude_m": 15.0,
        "terrain": {"kind": "flat", "size_m": [400.0, 400.0]},
        "buildings": [{"position_m": [0.0, 0.0], "size_m": [60.0, 10.0, 40.0]}],
        "radar.scan": {"mode": "conical", "incidence_deg": 80.0, "half_swath_deg": 30.0, "rotation_rpm": 600.0},
        "tracing.paths_per_pulse": 128,
        "radar.chirp_rate_hz": 1080.0,
        "platform.navigation.lever_arm_m": list(lever_arm_m),
    }
    radar = Radar(load_scenario("hills", keys))
    port, tilt = free_port(), {"roll": np.deg2rad(roll_deg), "pitch": np.deg2rad(pitch_deg)}
    vehicle, peer = MavlinkVehicle(f"udp:127.0.0.1:{port}", radar, clearance_m=10.0, clock=Clock()), Peer(port)
    for step in range(6):
        peer.odometry(BOOT_S + 0.05 * step, (0.0, -45.0 + 0.5 * step, -15.0), **tilt)
        poses = vehicle.wait(1.0)
        vehicle.send(radar.step(poses.time_s, poses.position_m, poses.euler_rad, poses.velocity_mps))
    whole = peer.answers("OBSTACLE_DISTANCE")
    vehicle.close()
    peer.close()
    nearest = [min(message.distances) for message in whole]
    assert min(nearest) == pytest.approx(3_750, abs=250)
    # In the last turn of the scan the wall is 37.5 to 38 m ahead, farther by 1 / cos of the angle beside the nose.
    ahead_m = 0.01 * np.min([message.distances for message in whole[-2:]], axis=0)
    for number in (-4, -2, 0, 2, 4):
        assert ahead_m[number] == pytest.approx(37.5 / np.cos(np.deg2rad(5.0 * number)), abs=2.0), number
    # Within 30 deg of the nose, from which it looked.
    assert all(message.distances[sector] == 65535 for message in whole for sector in range(8, 65))
    assert all(message.frame == 12 for message in whole)
