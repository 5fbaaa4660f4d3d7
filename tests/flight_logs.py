"""An analytic flight, and the same as a log of each kind, written here by hand or by somebody else's writer."""

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pyproj import CRS, Transformer
from scipy.spatial.transform import Rotation

from sionna_radar.elevation.local_frame import MapFrame
from sionna_radar.flight.log import local_frame_at

LON, LAT, HEIGHT = 8.5456, 47.3977, 488.0


@dataclass(frozen=True)
class Flown:
    """An analytic flight: metres about a place, attitudes from true north there."""

    time_s: np.ndarray
    place: np.ndarray
    velocity: np.ndarray
    euler: np.ndarray

    @property
    def quaternion(self) -> np.ndarray:
        return Rotation.from_euler("ZYX", self.euler[:, ::-1]).as_quat()

    @property
    def degrees(self) -> np.ndarray:
        """Longitude, latitude and height above sea level."""
        back = Transformer.from_crs(here().crs, CRS(4326), always_xy=True)
        lon, lat = back.transform(self.place[:, 0], self.place[:, 1])
        return np.column_stack([lon, lat, self.place[:, 2] + HEIGHT])


def here() -> MapFrame:
    return local_frame_at(LON, LAT)


def flown(time_s: np.ndarray) -> Flown:
    """Return a loop at 10 m/s through south, where headings wrap, climbing and descending."""
    rate, radius = 0.25, 40.0
    course = rate * time_s
    place = np.column_stack([radius * (1 - np.cos(course)), radius * np.sin(course), 50.0 + 3.0 * np.sin(0.4 * time_s)])
    velocity = np.column_stack(
        [radius * rate * np.sin(course), radius * rate * np.cos(course), 1.2 * np.cos(0.4 * time_s)]
    )
    euler = np.column_stack([0.3 + 0.1 * np.sin(time_s), 0.05 * np.cos(0.7 * time_s), course])
    return Flown(time_s, place, velocity, euler)


def regular(rate_hz: float = 20.0, duration_s: float = 20.0) -> np.ndarray:
    return np.arange(round(rate_hz * duration_s) + 1) / rate_hz


# ------------------------------------------------------------------------------------------ CSV and GPX


def csv_text(columns: Mapping[str, np.ndarray]) -> str:
    rows = [",".join("" if np.isnan(v) else f"{v:.9f}" for v in row) for row in np.column_stack(list(columns.values()))]
    return "\n".join([",".join(columns), *rows]) + "\n"


def csv_columns(flight: Flown, *, on_map: bool = False, attitude: str = "euler") -> dict[str, np.ndarray]:
    names = ("lon_deg", "lat_deg", "height_m") if on_map else ("east_m", "north_m", "up_m")
    columns = {"time_s": flight.time_s} | dict(zip(names, (flight.degrees if on_map else flight.place).T, strict=True))
    velocity = ("velocity_east_mps", "velocity_north_mps", "velocity_up_mps")
    columns |= dict(zip(velocity, flight.velocity.T, strict=True))
    if attitude == "euler":
        columns |= dict(zip(("roll_deg", "pitch_deg", "heading_deg"), np.rad2deg(flight.euler).T, strict=True))
    elif attitude == "quaternion":
        columns |= dict(zip(("qx", "qy", "qz", "qw"), flight.quaternion.T, strict=True))
    return columns


def write_csv(path: Path, flight: Flown, **kind: object) -> Path:
    path.write_text(csv_text(csv_columns(flight, **kind)), encoding="utf-8")
    return path


def write_gpx(path: Path, flight: Flown) -> Path:
    points = "\n".join(
        f'<trkpt lat="{lat:.9f}" lon="{lon:.9f}"><ele>{h:.4f}</ele>'
        f"<time>2024-05-01T10:{int(t) // 60:02d}:{t % 60:09.6f}Z</time></trkpt>"
        for t, (lon, lat, h) in zip(flight.time_s, flight.degrees, strict=True)
    )
    path.write_text(
        '<?xml version="1.0"?><gpx version="1.1" creator="test" xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>'
        f"{points}</trkseg></trk></gpx>",
        encoding="utf-8",
    )
    return path


# ------------------------------------------------------------------------------------------ SBET and HELIOS++


def write_sbet(path: Path, flight: Flown, wander: float = 0.0) -> Path:
    lon, lat, height = flight.degrees.T
    records = np.zeros((len(flight.time_s), 17))
    records[:, 0] = 302_400 + flight.time_s
    records[:, 1], records[:, 2], records[:, 3] = np.deg2rad(lat), np.deg2rad(lon), height
    records[:, 7:9] = flight.euler[:, :2]
    records[:, 9], records[:, 10] = flight.euler[:, 2] + wander, wander
    records.astype("<f8").tofile(path)
    return path


def write_trj(path: Path, flight: Flown) -> Path:
    """Write a trajectory in UTM zone 32, headings from true north, as HELIOS++ reads it."""
    to_map = Transformer.from_crs(CRS(4326), CRS(32632), always_xy=True)
    place = to_map.transform(*flight.degrees.T[:2])
    rows = np.column_stack([flight.time_s, np.rad2deg(flight.euler), *place, flight.degrees[:, 2]])
    text = "\n".join(",".join(f"{value:.9f}" for value in row) for row in rows)
    path.write_text(f'#TIME_COLUMN: 0\n#HEADER: "t", "roll", "pitch", "yaw", "x", "y", "z"\n{text}\n')
    return path


# ------------------------------------------------------------------------------------------ ULog


def ulog_bytes(topics: Mapping[str, Mapping[str, tuple[str, np.ndarray]]]) -> bytes:
    """Return a ULog of topics, each a table of C types and columns that begins with the timestamp."""
    codes = {"uint64_t": "Q", "float": "f", "double": "d", "bool": "?", "uint8_t": "B", "int32_t": "i"}

    def message(kind: str, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), ord(kind)) + body

    out = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0), message("B", bytes(40))]
    rows = []
    for number, (topic, columns) in enumerate(topics.items()):
        arrays: dict[str, tuple[str, int]] = {}
        for key, (kind, _) in columns.items():
            name = key.split("[")[0]
            arrays[name] = (kind, arrays.get(name, (kind, 0))[1] + ("[" in key))
        fields = ";".join(f"{kind}[{n}] {name}" if n else f"{kind} {name}" for name, (kind, n) in arrays.items())
        out.append(message("F", f"{topic}:{fields};".encode()))
        rows.append(message("A", struct.pack("<BH", 0, number) + topic.encode()))
        layout = "<H" + "".join(codes[kind] for kind, _ in columns.values())
        casts: list[Callable] = [int if codes[kind] in "QBi" else float for kind, _ in columns.values()]
        for values in zip(*(column for _, column in columns.values()), strict=True):
            body = struct.pack(layout, number, *(cast(v) for cast, v in zip(casts, values, strict=True)))
            rows.append(message("D", body))
    return b"".join(out + rows)


def ulog_topics(flight: Flown) -> dict[str, dict[str, tuple[str, np.ndarray]]]:
    time_us = flight.time_s * 1e6 + 1e7
    ones = np.ones(len(time_us))
    # PX4's projection, written with another library: azimuthal equidistant on its sphere.
    sphere = CRS.from_dict({"proj": "aeqd", "lat_0": LAT, "lon_0": LON, "R": 6371000.0, "units": "m"})
    lon, lat, _ = flight.degrees.T
    geographic = CRS.from_dict({"proj": "longlat", "R": 6371000.0})
    east, north = Transformer.from_crs(geographic, sphere, always_xy=True).transform(lon, lat)
    local = {
        "timestamp": ("uint64_t", time_us),
        "ref_lat": ("double", LAT * ones),
        "ref_lon": ("double", LON * ones),
        "ref_alt": ("float", HEIGHT * ones),
        "x": ("float", north),
        "y": ("float", east),
        "z": ("float", -flight.place[:, 2]),
        "vx": ("float", flight.velocity[:, 1]),
        "vy": ("float", flight.velocity[:, 0]),
        "vz": ("float", -flight.velocity[:, 2]),
        "delta_xy[0]": ("float", 0 * ones),
        "delta_xy[1]": ("float", 0 * ones),
        "delta_z": ("float", 0 * ones),
        "eph": ("float", 0.3 * np.sqrt(2) * ones),
        "epv": ("float", 0.5 * ones),
        "xy_reset_counter": ("uint8_t", 0 * ones),
        "z_reset_counter": ("uint8_t", 0 * ones),
        "xy_valid": ("bool", ones),
        "z_valid": ("bool", ones),
        "xy_global": ("bool", ones),
    }
    turned = flight.quaternion[:, [3, 0, 1, 2]]
    attitude = {"timestamp": ("uint64_t", time_us)} | {f"q[{i}]": ("float", turned[:, i]) for i in range(4)}
    return {"vehicle_local_position": local, "vehicle_attitude": attitude}


def write_ulog(path: Path, flight: Flown) -> Path:
    path.write_bytes(ulog_bytes(ulog_topics(flight)))
    return path


# ------------------------------------------------------------------------------------------ DataFlash


def dataflash_bytes(messages: Mapping[str, tuple[str, Mapping[str, np.ndarray]]]) -> bytes:
    """Return a DataFlash log of messages: format characters and columns."""
    codes = {"Q": "Q", "L": "i", "f": "f", "c": "h", "C": "H", "B": "B", "e": "i", "h": "h", "I": "I"}
    scale = {"L": 1e7, "c": 100.0, "C": 100.0, "e": 100.0}

    def described(number: int, name: str, characters: str, columns: str) -> bytes:
        length = 3 + struct.calcsize("<" + "".join(codes.get(c, c) for c in characters)) if name != "FMT" else 89
        return b"\xa3\x95\x80" + struct.pack(
            "<BB4s16s64s", number, length, name.encode(), characters.encode(), columns.encode()
        )

    out = [described(0x80, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")]
    for number, (name, (characters, columns)) in enumerate(messages.items(), start=1):
        out.append(described(number, name, characters, ",".join(columns)))
    rows = []
    for number, (characters, columns) in enumerate(messages.values(), start=1):
        for values in zip(*columns.values(), strict=True):
            whole = [
                round(float(v) * scale.get(c, 1.0)) if codes[c] not in "f" else float(v)
                for c, v in zip(characters, values, strict=True)
            ]
            layout = "<" + "".join(codes[c] for c in characters)
            rows.append((values[0], b"\xa3\x95" + bytes([number]) + struct.pack(layout, *whole)))
    return b"".join([*out, *(body for _, body in sorted(rows, key=lambda row: row[0]))])


def dataflash_messages(flight: Flown) -> dict[str, tuple[str, dict[str, np.ndarray]]]:
    time_us = flight.time_s * 1e6 + 2e7
    lon, lat, height = flight.degrees.T
    heading = np.mod(np.rad2deg(flight.euler[:, 2]), 360.0)
    roll, pitch = np.rad2deg(flight.euler[:, :2]).T
    attitude = {"TimeUS": time_us, "Roll": roll, "Pitch": pitch, "Yaw": heading}
    filtered = {"TimeUS": time_us, "C": 0 * time_us, "VN": flight.velocity[:, 1], "VE": flight.velocity[:, 0]}
    innovations = {f"I{kind}{axis}": 0.2 + 0 * time_us for kind in "VP" for axis in "NED"}
    return {
        "POS": ("QLLf", {"TimeUS": time_us, "Lat": lat, "Lng": lon, "Alt": height}),
        "ATT": ("QccC", attitude),
        "XKF1": ("QBfff", filtered | {"VD": -flight.velocity[:, 2]}),
        "XKF3": ("QBffffff", {"TimeUS": time_us, "C": 0 * time_us} | innovations),
    }


def write_dataflash(path: Path, flight: Flown) -> Path:
    path.write_bytes(dataflash_bytes(dataflash_messages(flight)))
    return path


# ------------------------------------------------------------------------------------------ telemetry


def telemetry_bytes(flight: Flown, start_ms: int = 5000) -> bytes:
    """Return a telemetry log, packed by pymavlink."""
    from pymavlink.dialects.v20 import common

    packer = common.MAVLink(None, srcSystem=1, srcComponent=1)
    out = []
    for t, (lon, lat, h), v, euler in zip(flight.time_s, flight.degrees, flight.velocity, flight.euler, strict=True):
        boot = round(t * 1000) + start_ms
        heading = float(np.mod(euler[2] + np.pi, 2 * np.pi) - np.pi)
        place = packer.global_position_int_encode(
            boot, round(lat * 1e7), round(lon * 1e7), round(h * 1e3), round((h - HEIGHT) * 1e3),
            round(v[1] * 100), round(v[0] * 100), round(-v[2] * 100), 0,
        )  # fmt: skip
        turned = packer.attitude_encode(boot, float(euler[0]), float(euler[1]), heading, 0.0, 0.0, 0.0)
        for message in (packer.heartbeat_encode(2, 3, 0, 0, 0), place, turned):
            out.append(struct.pack(">Q", round((1.7e9 + t) * 1e6)) + message.pack(packer))
    return b"".join(out)


def write_telemetry(path: Path, flight: Flown) -> Path:
    path.write_bytes(telemetry_bytes(flight))
    return path


WRITERS: dict[str, tuple[str, Callable[[Path, Flown], Path]]] = {
    "csv": ("flight.csv", lambda path, flight: write_csv(path, flight, on_map=True)),
    "gpx": ("flight.gpx", write_gpx),
    "ulog": ("flight.ulg", write_ulog),
    "dataflash": ("flight.bin", write_dataflash),
    "telemetry": ("flight.tlog", write_telemetry),
}
