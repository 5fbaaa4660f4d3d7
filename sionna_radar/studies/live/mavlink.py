"""MAVLink: poses from an autopilot, distances and obstacles back to it (https://mavlink.io/en/messages/).

Poses are ODOMETRY, or ATTITUDE with LOCAL_POSITION_NED or GLOBAL_POSITION_INT. Readings are DISTANCE_SENSOR for a beam
that stands still, and OBSTACLE_DISTANCE with OBSTACLE_DISTANCE_3D for one that scans. Time is that of the peer: a
reading bears the time of its pulse on the peer's clock, however late it is sent.
"""

import os
import socket
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt16
from scipy.spatial.transform import Rotation

from sionna_radar.elevation.local_frame import frame_of
from sionna_radar.flight.frames import R_WORLD_NED, world_from_body
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.raster import Georeference
from sionna_radar.studies.live.frame import Frame
from sionna_radar.studies.live.poses import Poses
from sionna_radar.studies.live.radar import Radar

# A clock that advances by so much more than time passed here, or falls back by as much, was set, s.
CLOCK_STEP_S = 1.0
# Oldest attitude that a position is combined with, s.
ATTITUDE_AGE_S = 0.2
# Half the height of the layer about the vehicle whose echoes are obstacles in its way, m.
CLEARANCE_M = 5.0
# Obstacles reported by place in each frame, the nearest first.
NEAREST_OBSTACLES = 16
SECTORS, UNKNOWN, UNKNOWN_VARIANCE = 72, 65535, 255
# Numbers of MAVLink: frames, orientations, and the component that avoids obstacles.
LOCAL_NED, BODY_FRAMES, BODY_FRD = 1, (8, 12), 12
RADAR_TYPE, FORWARD, DOWNWARD, CUSTOM = 3, 0, 25, 100
ONBOARD_COMPUTER, OBSTACLE_AVOIDANCE, NO_AUTOPILOT, ACTIVE = 18, 196, 8, 4
# Kinds of connections of pymavlink; those of the first row have a host and a port.
NETWORK = ("udp", "udpin", "udpout", "udpbcast", "tcp", "tcpin")
OTHER_KINDS = ("mcast", "uds", "unix", "ws", "wss", "wsserver")
USUAL_SYSTEM = 1
POSES = ("ODOMETRY", "ATTITUDE", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT")


class MavlinkVehicle:
    """The autopilot of a vehicle that carries the radar.

    address: as pymavlink takes it: udp:127.0.0.1:14550 listens, udpout:HOST:PORT sends first.
    radar: whose beam and place on the map messages need.
    system: MAVLink number of the vehicle; None for that of the first pose.
    origin_m: local east, north and up of the origin of the autopilot's local frame.
    clearance_m: half the height of the layer about the vehicle in which echoes are obstacles.
    sensor: number of the sensor in DISTANCE_SENSOR.
    clock: time that passes here, s.

    Raises ScenarioError without pymavlink, or for an address that is none or is taken.
    """

    def __init__(
        self,
        address: str,
        radar: Radar,
        *,
        system: int | None = None,
        origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
        clearance_m: float = CLEARANCE_M,
        sensor: int = 0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._link, self._radar, self._system = _opened(address), radar, system
        # A component bears its vehicle's number: another one, such as pymavlink's 255, is a ground station's.
        self._link.mav.srcSystem = USUAL_SYSTEM if system is None else system
        self._origin_m, self._clearance_m, self._clock = np.array(origin_m), clearance_m, clock
        self._sensor = sensor
        self._place: Georeference | None = radar.prepared.world.scene.georeference
        self._north_rad = 0.0 if self._place is None else np.deg2rad(self._place.convergence_deg)
        self.counts: Counter[str] = Counter()
        # Of the peer's clock: its last time, when that came here, and the radar's time less it.
        self._peer_s, self.came_s, self._offset_s = -np.inf, -np.inf, 0.0
        self._radar_s, self._last, self._beat_s = 0.0, dict[str, float](), -np.inf
        # Time, angles, rates and system of the last attitude; the kind of position that counts, and when the last came.
        self._attitude: tuple[float, np.ndarray, np.ndarray, int] | None = None
        self._kind, self._kind_s = "", -np.inf

    def close(self) -> None:
        """Close the connection."""
        self._link.close()

    def wait(self, seconds: float) -> Poses | None:
        """Return the poses that have arrived, waiting for one as long as given; None without one."""
        self._heartbeat()
        message = self._link.recv_match(blocking=True, timeout=seconds)
        rows = []
        while message is not None:
            if (pose := self._pose(message)) is not None:
                rows.append(pose)
            message = self._link.recv_match(blocking=False)
        if not rows:
            return None
        columns = (np.array(column) for column in zip(*rows, strict=True))
        return Poses(
            **dict(zip(("time_s", "position_m", "euler_rad", "velocity_mps", "turn_rad_s"), columns, strict=True))
        )

    def _pose(self, message: Any) -> tuple[Any, ...] | None:
        """Return time, position, attitude, velocity and turn rate of a message; None for another or a useless one."""
        kind = message.get_type()
        if kind == "BAD_DATA":
            self.counts["damaged"] += 1
        if kind not in POSES:
            return None
        if self._system is None and kind != "ATTITUDE":
            self._link.mav.srcSystem = self._system = message.get_srcSystem()
        if self._system is not None and message.get_srcSystem() != self._system:
            self.counts["of another system"] += 1
            return None
        self.counts[kind] += 1
        stamped = message.time_usec / 1e6 if kind == "ODOMETRY" else message.time_boot_ms / 1e3
        if kind == "ATTITUDE":
            if stamped == self._last.get(kind):
                self.counts["doubled"] += 1
            elif -CLOCK_STEP_S <= stamped - self._last.get(kind, -np.inf) < 0:
                self.counts["late"] += 1
            else:
                self._last[kind] = stamped
                angles, rates = (np.array([getattr(message, key) for key in keys]) for keys in ATTITUDE)
                self._attitude = stamped, angles, rates, message.get_srcSystem()
            return None
        # Of several kinds of positions, which may have clocks and origins of their own, the first counts.
        if kind != self._kind and self._clock() - self._kind_s < CLOCK_STEP_S:
            self.counts["beside another kind of position"] += 1
            return None
        if not self._is_new(kind, stamped):
            return None
        pose = self._odometry(message) if kind == "ODOMETRY" else self._position(kind, message, stamped)
        if pose is None or not np.isfinite(np.concatenate(pose)).all():
            self.counts["without a usable pose"] += 1
            return None
        time_s = stamped + self._offset_s
        if time_s <= self._radar_s:
            self.counts["late"] += 1
            return None
        self._radar_s, self._kind, self._kind_s = time_s, kind, self._clock()
        return time_s, *pose

    def _is_new(self, kind: str, stamped_s: float) -> bool:
        """Count a message that is doubled or late, and follow a clock that was set."""
        now_s = self._clock()
        advanced_s, passed_s = stamped_s - self._peer_s, now_s - self.came_s
        if not np.isfinite(self._peer_s):
            self._offset_s = CLOCK_STEP_S - stamped_s
        elif advanced_s < -CLOCK_STEP_S or advanced_s > passed_s + CLOCK_STEP_S:
            self.counts["clock set"] += 1
            # The radar's time goes on by what passed here.
            self._offset_s = self._radar_s + max(passed_s, 1e-3) - stamped_s
            self._last, self._peer_s = {}, -np.inf
        elif stamped_s == self._last.get(kind):
            self.counts["doubled"] += 1
            return False
        elif stamped_s < self._last.get(kind, -np.inf):
            self.counts["late"] += 1
            return False
        self._last[kind] = stamped_s
        if stamped_s >= self._peer_s:
            self._peer_s, self.came_s = stamped_s, now_s
        return True

    def _odometry(self, message: Any) -> tuple[Any, ...] | None:
        if message.frame_id != LOCAL_NED or message.child_frame_id not in (*BODY_FRAMES, LOCAL_NED):
            self.counts["in another frame"] += 1
            return None
        w, x, y, z = message.q
        if not np.isclose(w * w + x * x + y * y + z * z, 1.0, atol=1e-2):
            return None
        turned = Rotation.from_quat([x, y, z, w])
        velocity = np.array([message.vx, message.vy, message.vz])
        if message.child_frame_id in BODY_FRAMES:
            velocity = turned.apply(velocity)
        turn = np.array([message.rollspeed, message.pitchspeed, message.yawspeed])
        return self._local([message.x, message.y, message.z], turned.as_euler("ZYX")[::-1], velocity, turn)

    def _position(self, kind: str, message: Any, stamped_s: float) -> tuple[Any, ...] | None:
        attitude = self._attitude
        if attitude is None or attitude[3] != self._system or abs(stamped_s - attitude[0]) > ATTITUDE_AGE_S:
            self.counts["without an attitude"] += 1
            return None
        at_s, euler, rates, _ = attitude
        turned = Rotation.from_euler("ZYX", euler[::-1]) * Rotation.from_rotvec((stamped_s - at_s) * rates)
        euler = turned.as_euler("ZYX")[::-1]
        if kind == "LOCAL_POSITION_NED":
            velocity = np.array([message.vx, message.vy, message.vz])
            return self._local([message.x, message.y, message.z], euler, velocity, rates)
        frame = frame_of(self._place)
        if frame is None or self._place is None:
            self.counts["without a map"] += 1
            return None
        from pyproj import CRS

        lon, lat = np.array([message.lon / 1e7]), np.array([message.lat / 1e7])
        east, north = frame.local_of(CRS(4326), lon, lat)
        velocity = np.array([message.vx, message.vy, message.vz]) / 100
        _, euler, velocity, rates = self._local([0.0, 0.0, 0.0], euler, velocity, rates)
        return np.array([east[0], north[0], message.alt / 1000 - self._place.origin_m[2]]), euler, velocity, rates

    def _local(self, ned_m: Any, euler: Any, velocity: Any, turn: Any) -> tuple[Any, ...]:
        """Return position, attitude, velocity and turn rate in the radar's frame, whose north is that of the map."""
        true_north = Rotation.from_rotvec([0.0, 0.0, self._north_rad])
        position, velocity = (true_north.apply(R_WORLD_NED @ np.asarray(each)) for each in (ned_m, velocity))
        return self._origin_m + position, euler - np.array([0.0, 0.0, self._north_rad]), velocity, turn

    def send(self, frame: Frame) -> None:
        """Send what a frame heard: a distance, or obstacles."""
        if len(frame) == 0:
            return
        if frame.pulses.scan_rad.any() or frame.pulses.beam is not None or self._radar.prepared.instrument.frames:
            self._send_obstacles(frame)
        else:
            self._send_distance(frame)

    def _send_distance(self, frame: Frame) -> None:
        """Send the reading of the last pulse of a beam that stands still; quality is the share of pulses with one."""
        prepared, reading_m = self._radar.prepared, frame.readings_m
        pose, last, farthest_cm = frame.pulses.measured, len(frame) - 1, self._farthest_cm
        # What lies beyond the message's numbers cannot be told as a distance.
        valid = 100 * reading_m <= farthest_cm
        of_last = frame.echoes.pulse == frame.pulses.index[last]
        sigma_m = float(frame.echoes.range_sigma_m[of_last].max(initial=0.0))
        body = self._R_body_world(frame, last) @ pose.boresight[last]
        orientation = DOWNWARD if body[2] > 0.999 else FORWARD if body[0] > 0.999 else CUSTOM
        turned = Rotation.align_vectors(body[None], [[1.0, 0.0, 0.0]])[0].as_quat()
        azimuth, elevation = prepared.instrument.antenna.beamwidths_rad
        self._link.mav.distance_sensor_send(
            self._boot_ms(frame.pulses.time_s[last]),
            self._nearest_cm,
            farthest_cm,
            max(round(float(reading_m[last]) * 100), 0) if valid[last] else farthest_cm,
            RADAR_TYPE,
            self._sensor,
            orientation,
            _variance_cm2(sigma_m) if valid[last] else UNKNOWN_VARIANCE,
            float(azimuth),
            float(elevation),
            [float(turned[3]), *map(float, turned[:3])] if orientation == CUSTOM else [0.0] * 4,
            max(2, round(100 * valid.mean())) if valid[last] else 1,
        )
        self.counts["DISTANCE_SENSOR"] += 1

    def _send_obstacles(self, frame: Frame) -> None:
        """Send the nearest echo in each direction, and the nearest by place, of those about the vehicle's height.

        Both count from the vehicle, not from its antenna. Sectors are level, whatever roll and pitch are: autopilots
        turn them by the heading alone.
        """
        last = len(frame) - 1
        R_body_world = self._R_body_world(frame, last)
        lever_m = np.array(self._radar.prepared.flight.lever_arm_m)
        origin_m = frame.pulses.measured.position_m[last] - lever_m @ R_body_world
        away = (frame.points.position_m - origin_m).astype(np.float64)
        away = away[np.abs(away[:, 2]) <= self._clearance_m]
        east, north, _ = R_body_world[0]
        R_level_world = np.array([[east, north, 0.0], [north, -east, 0.0]]) / np.hypot(east, north)
        boot_ms = self._boot_ms(frame.pulses.time_s[last])
        nearest_cm, farthest_cm = self._nearest_cm, self._farthest_cm
        distances = sectors(frame.pulses.measured.boresight @ R_level_world.T, away @ R_level_world.T, farthest_cm)
        self._link.mav.obstacle_distance_send(
            self._peer_us(frame.pulses.time_s[last]),
            RADAR_TYPE,
            distances.tolist(),
            0,
            nearest_cm,
            farthest_cm,
            360 / SECTORS,
            0.0,
            BODY_FRD,
        )
        self.counts["OBSTACLE_DISTANCE"] += 1
        body = away @ R_body_world.T
        order = np.argsort(np.linalg.norm(body, axis=1))[:NEAREST_OBSTACLES]
        for number, (x, y, z) in enumerate(body[order].tolist()):
            self._link.mav.obstacle_distance_3d_send(
                boot_ms, RADAR_TYPE, BODY_FRD, number, x, y, z, nearest_cm / 100, farthest_cm / 100
            )
            self.counts["OBSTACLE_DISTANCE_3D"] += 1

    def _R_body_world(self, frame: Frame, row: int) -> Float[np.ndarray, "3 3"]:
        """Return the rotation from the world, as the navigation has it, to the body: its encoders know the antenna."""
        pulses = frame.pulses
        R_world_body = world_from_body(self._radar.attitude(pulses.time_s[row : row + 1]))[0]
        R_body_antenna = R_world_body.T @ pulses.true.R_world_antenna[row]
        return R_body_antenna @ pulses.measured.R_world_antenna[row].T

    @property
    def _nearest_cm(self) -> int:
        return min(round(self._radar.prepared.instrument.detector.min_range_m * 100), UNKNOWN - 2)

    @property
    def _farthest_cm(self) -> int:
        return min(round(self._radar.prepared.receiver.chirp.max_range_m * 100), UNKNOWN - 2)

    def _boot_ms(self, time_s: float) -> int:
        """Return a time of the radar on the peer's clock; rounded down, so that no reading is older than it says.

        Messages hold 32 bits of it: of a clock that counts from 1970 they tell the rest by seven weeks.
        """
        return self._peer_us(time_s) // 1000 % 2**32

    def _peer_us(self, time_s: float) -> int:
        return int(max(time_s - self._offset_s, 0.0) * 1e6)

    def _heartbeat(self) -> None:
        if (now_s := self._clock()) - self._beat_s >= 1.0:
            self._link.mav.heartbeat_send(ONBOARD_COMPUTER, NO_AUTOPILOT, 0, 0, ACTIVE)
            self._beat_s = now_s


def _variance_cm2(sigma_m: float) -> int:
    """Return the variance of a distance, rounded up; unknown where it is larger than a message holds."""
    variance_cm2 = float(np.ceil((100 * sigma_m) ** 2))
    return int(variance_cm2) if variance_cm2 < UNKNOWN_VARIANCE else UNKNOWN_VARIANCE


ATTITUDE = (("roll", "pitch", "yaw"), ("rollspeed", "pitchspeed", "yawspeed"))


def sectors(
    looked: Float[np.ndarray, "pulse 2"], obstacle_m: Float[np.ndarray, "obstacle 2"], farthest_cm: int
) -> UInt16[np.ndarray, "72"]:
    """Return the distance in each sector about the vehicle, cm, clockwise from the nose.

    One more than the farthest without an obstacle, and 65535 where the radar did not look.

    looked: level directions of the beams, along the heading and to its right.
    obstacle_m: places of the obstacles, in the same axes.
    """

    def sector(of: Float[np.ndarray, "n 2"]) -> Any:
        return np.round(np.arctan2(of[:, 1], of[:, 0]) * SECTORS / (2 * np.pi)).astype(np.int64) % SECTORS

    distances = np.full(SECTORS, UNKNOWN)
    distances[sector(looked)] = farthest_cm + 1
    range_cm = np.round(np.linalg.norm(obstacle_m, axis=1) * 100).astype(np.int64)
    np.minimum.at(distances, sector(obstacle_m), np.minimum(range_cm, farthest_cm + 1))
    return distances.astype(np.uint16)


def _opened(address: str) -> Any:
    # Distances with their quality, and ODOMETRY, are of MAVLink 2; pymavlink reads the choice when it is imported.
    os.environ.setdefault("MAVLINK20", "1")
    try:
        from pymavlink import mavutil
    except ModuleNotFoundError as error:
        raise ScenarioError.of_option("--mavlink", "needs pymavlink; install sionna-radar[live]") from error
    try:
        kind, *where = address.split(":")
        if kind in NETWORK:
            host, port = where
            if not 0 < int(port) < 65_536:
                raise ValueError("ports are 1 to 65535")
            socket.getaddrinfo(host, int(port))
        elif kind not in OTHER_KINDS and not _is_serial(address):
            raise ValueError("neither an address in a network nor a serial port")
        return mavutil.mavlink_connection(
            address, source_component=OBSTACLE_AVOIDANCE, dialect="ardupilotmega", autoreconnect=True
        )
    except (OSError, ValueError, OverflowError, ImportError) as error:  # pyserial and websockets are extras of it
        message = f"{address!r} cannot be opened ({error}); give one such as udp:127.0.0.1:14550 that no program uses"
        raise ScenarioError.of_option("--mavlink", message) from error


def _is_serial(address: str) -> bool:
    """Return True if an address is a serial port; pymavlink would read a file as a log."""
    return Path(address).is_char_device() or (os.name == "nt" and address.upper().startswith("COM"))
