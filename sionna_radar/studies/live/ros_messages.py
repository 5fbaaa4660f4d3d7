"""Frames as messages of ROS 2 in an MCAP file, which ROS, Foxglove and rosbags read (https://mcap.dev).

/radar/points   sensor_msgs/PointCloud2: x, y, z in the frame `map`, range rate of still ground m/s, SNR dB, sigma m
/radar/range    sensor_msgs/Range: strongest echo of the last pulse of a frame; +inf without one, as REP 117 has it
/tf             tf2_msgs/TFMessage: `base_link` (nose, left, up) in `map` (east, north, up), and `radar` (along the axis
                of the beam, left, up) in `base_link`
/radar/dem      grid_map_msgs/GridMap: layers `elevation` and `sigma`

Times are those of the flight, from zero. Places are those that the navigation reports, as points are: the pose of
`base_link` errs as it does, the error of the mount's angles included.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from sionna_radar.flight.frames import world_from_body
from sionna_radar.foundation.errors import OutputError, ScenarioError
from sionna_radar.foundation.input_file import shown
from sionna_radar.foundation.raster import Raster
from sionna_radar.studies.live.frame import Frame
from sionna_radar.studies.live.radar import Radar

# Axes nose, right, down from axes nose, left, up; of the antenna likewise, with the beam for the nose.
FRD_FROM_FLU = np.diag([1.0, -1.0, -1.0])
FLOAT32, INFRARED = 7, 1  # Range knows ultrasound and infrared alone
FIELDS = ("x", "y", "z", "range_rate", "snr", "sigma")

_HEADER = "std_msgs/Header header\n"
_TIME = "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec"
_OF_HEADER = ("MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id", _TIME)
_POINT = "MSG: geometry_msgs/{}\nfloat64 x\nfloat64 y\nfloat64 z"
_QUATERNION = "MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w"
DEFINITIONS = {
    "sensor_msgs/msg/PointCloud2": (
        _HEADER + "uint32 height\nuint32 width\nsensor_msgs/PointField[] fields\nbool is_bigendian\nuint32 point_step\n"
        "uint32 row_step\nuint8[] data\nbool is_dense",
        *_OF_HEADER,
        "MSG: sensor_msgs/PointField\nstring name\nuint32 offset\nuint8 datatype\nuint32 count",
    ),
    "sensor_msgs/msg/Range": (
        _HEADER + "uint8 radiation_type\nfloat32 field_of_view\nfloat32 min_range\nfloat32 max_range\nfloat32 range",
        *_OF_HEADER,
    ),
    "tf2_msgs/msg/TFMessage": (
        "geometry_msgs/TransformStamped[] transforms",
        "MSG: geometry_msgs/TransformStamped\n" + _HEADER + "string child_frame_id\ngeometry_msgs/Transform transform",
        "MSG: geometry_msgs/Transform\ngeometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
        _POINT.format("Vector3"),
        _QUATERNION,
        *_OF_HEADER,
    ),
    "grid_map_msgs/msg/GridMap": (
        _HEADER + "grid_map_msgs/GridMapInfo info\nstring[] layers\nstring[] basic_layers\n"
        "std_msgs/Float32MultiArray[] data\nuint16 outer_start_index\nuint16 inner_start_index",
        "MSG: grid_map_msgs/GridMapInfo\nfloat64 resolution\nfloat64 length_x\nfloat64 length_y\n"
        "geometry_msgs/Pose pose",
        "MSG: geometry_msgs/Pose\ngeometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
        _POINT.format("Point"),
        _QUATERNION,
        "MSG: std_msgs/Float32MultiArray\nstd_msgs/MultiArrayLayout layout\nfloat32[] data",
        "MSG: std_msgs/MultiArrayLayout\nstd_msgs/MultiArrayDimension[] dim\nuint32 data_offset",
        "MSG: std_msgs/MultiArrayDimension\nstring label\nuint32 size\nuint32 stride",
        *_OF_HEADER,
    ),
}
TOPICS = dict(zip(("/radar/points", "/radar/range", "/tf", "/radar/dem"), DEFINITIONS, strict=True))
SEPARATOR = "\n" + 80 * "=" + "\n"
BAG_VERSION = 5


@contextmanager
def recorded(files: Mapping[Path, bool], radar: Radar | None) -> Iterator[list["RosRecorder"]]:
    """Open recorders of files, or of folders of a rosbag2 where marked; an error leaves none of them behind."""
    recorders: list[RosRecorder] = []
    try:
        for path, bag in files.items():
            recorders.append(RosRecorder(path, radar, bag=bag))
        yield recorders
    except BaseException:
        for recorder in recorders:
            recorder.discard()
        raise


class RosRecorder:
    """Writes frames as messages.

    path: the MCAP file, which must not exist; with `bag` the folder of a rosbag2, with `metadata.yaml` beside the file.
    radar: whose vehicle and beam they are; None for a recording, of which only the beam's place is known.

    Raises ScenarioError without mcap, and OutputError if the path exists, or cannot be written.
    """

    def __init__(self, path: Path, radar: Radar | None, *, bag: bool = False) -> None:
        try:
            from mcap_ros2.writer import Writer
        except ModuleNotFoundError as error:
            message = "needs mcap-ros2-support; install sionna-radar[live]"
            raise ScenarioError.of_option("--rosbag" if bag else "--mcap", message) from error
        self._folder, self._radar = path if bag else None, radar
        try:
            if bag:
                path.mkdir(parents=True)
            self._file = (path / f"{path.name}_0.mcap" if bag else path).open("xb")
        except OSError as error:
            message = f"{shown(path)}: {error.strerror or error}; name a new one, in a folder that can be written"
            raise OutputError(message) from error
        self._writer = Writer(self._file)
        self._schemas = {
            name: self._writer.register_msgdef(name, SEPARATOR.join(parts)) for name, parts in DEFINITIONS.items()
        }
        self._counts = dict.fromkeys(TOPICS, 0)
        self._first_ns: int | None = None
        self._last_ns = 0

    def take(self, frame: Frame) -> None:
        """Write the points, the reading and the place of a frame."""
        if len(frame) == 0:
            return
        pose, last = frame.pulses.measured, len(frame) - 1
        stamp = float(frame.pulses.time_s[last])
        points, rows = frame.points, frame.pulses.row_of(frame.points.pulse)
        toward = points.position_m - points.origin_m
        toward /= np.maximum(np.linalg.norm(toward, axis=1), 1e-9)[:, None]
        rate_mps = -np.einsum("pi,pi->p", pose.velocity_mps[rows], toward)
        values = np.column_stack([points.position_m, rate_mps, points.echo_snr_db, points.range_sigma_m])
        fields = [
            {"name": name, "offset": 4 * place, "datatype": FLOAT32, "count": 1} for place, name in enumerate(FIELDS)
        ]
        step = 4 * len(FIELDS)
        cloud = {
            "height": 1, "width": len(points), "fields": fields, "is_bigendian": False, "point_step": step,
            "row_step": step * len(points), "data": values.astype("<f4").tobytes(), "is_dense": True,
        }  # fmt: skip
        self._write("/radar/points", stamp, self._headed(stamp, "map", cloud))
        if self._radar is None:
            return
        prepared, reading_m = self._radar.prepared, float(frame.readings_m[last])
        reading = {
            "radiation_type": INFRARED,
            "field_of_view": float(prepared.instrument.antenna.beamwidths_rad[0]),
            "min_range": float(prepared.instrument.detector.min_range_m),
            "max_range": float(prepared.receiver.chirp.max_range_m),
            "range": reading_m if np.isfinite(reading_m) else np.inf,
        }
        self._write("/radar/range", stamp, self._headed(stamp, "radar", reading))
        # Encoders know the antenna in the body, the navigation the antenna in the world.
        R_world_true = world_from_body(self._radar.attitude(frame.pulses.time_s[last:]))[0]
        R_body_antenna = R_world_true.T @ frame.pulses.true.R_world_antenna[last]
        R_world_body = pose.R_world_antenna[last] @ R_body_antenna.T
        lever_arm_m = np.array(prepared.flight.lever_arm_m)
        place = pose.position_m[last] - R_world_body @ lever_arm_m
        body = self._transform(stamp, "map", "base_link", place, R_world_body @ FRD_FROM_FLU)
        beam = FRD_FROM_FLU.T @ R_body_antenna @ FRD_FROM_FLU
        radar = self._transform(stamp, "base_link", "radar", FRD_FROM_FLU.T @ lever_arm_m, beam)
        self._write("/tf", stamp, {"transforms": [body, radar]})

    def discard(self) -> None:
        """Remove what was written."""
        self._file.close()
        Path(self._file.name).unlink(missing_ok=True)
        if self._folder is not None:
            self._folder.rmdir()

    def finish(self, dem: Raster | None, sigma: Raster | None) -> None:
        """Write the map, and close the file."""
        if dem is not None:
            layers = {"elevation": dem, **({} if sigma is None else {"sigma": sigma})}
            west, east, south, north = dem.grid.extent_m
            rows, columns = dem.grid.shape
            middle = {"x": (west + east) / 2, "y": (south + north) / 2, "z": 0.0}
            info = {
                "resolution": dem.grid.spacing_m,
                "length_x": east - west,
                "length_y": north - south,
                "pose": {"position": middle, "orientation": _turned(np.eye(3))},
            }
            # Column-major from the north-east corner, the first index toward -x, the second toward -y.
            dims = [
                {"label": "column_index", "size": rows, "stride": rows * columns},
                {"label": "row_index", "size": columns, "stride": columns},
            ]
            data = [
                {"layout": {"dim": dims, "data_offset": 0}, "data": each.height_m[::-1, ::-1].ravel().tolist()}
                for each in layers.values()
            ]
            grid = {
                "info": info, "layers": list(layers), "basic_layers": ["elevation"], "data": data,
                "outer_start_index": 0, "inner_start_index": 0,
            }  # fmt: skip
            stamp = self._last_ns / 1e9
            self._write("/radar/dem", stamp, self._headed(stamp, "map", grid))
        self._writer.finish()
        self._file.close()
        if self._folder is not None:
            (self._folder / "metadata.yaml").write_text(self._metadata(self._folder.name), encoding="utf-8")

    def _write(self, topic: str, stamp_s: float, message: dict[str, Any]) -> None:
        at_ns = round(stamp_s * 1e9)
        self._writer.write_message(topic, self._schemas[TOPICS[topic]], message, at_ns, at_ns, self._counts[topic])
        self._counts[topic] += 1
        self._first_ns, self._last_ns = at_ns if self._first_ns is None else self._first_ns, max(self._last_ns, at_ns)

    def _transform(self, stamp_s: float, parent: str, child: str, place_m: Any, R: Any) -> dict[str, Any]:
        transform = {"translation": dict(zip("xyz", map(float, place_m), strict=True)), "rotation": _turned(R)}
        return self._headed(stamp_s, parent, {"child_frame_id": child, "transform": transform})

    @staticmethod
    def _headed(stamp_s: float, frame: str, message: dict[str, Any]) -> dict[str, Any]:
        sec, nanosec = divmod(round(stamp_s * 1e9), 10**9)
        return {"header": {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": frame}, **message}

    def _metadata(self, name: str) -> str:
        first_ns = self._first_ns or 0
        topics = "".join(
            f"    - topic_metadata:\n        name: {topic}\n        type: {kind}\n        serialization_format: cdr\n"
            f"        offered_qos_profiles: ''\n      message_count: {self._counts[topic]}\n"
            for topic, kind in TOPICS.items()
            if self._counts[topic]
        )
        return (
            f"rosbag2_bagfile_information:\n  version: {BAG_VERSION}\n  storage_identifier: mcap\n"
            f"  relative_file_paths:\n    - {name}_0.mcap\n  duration:\n    nanoseconds: {self._last_ns - first_ns}\n"
            f"  starting_time:\n    nanoseconds_since_epoch: {first_ns}\n"
            f"  message_count: {sum(self._counts.values())}\n  topics_with_message_count:\n{topics}"
            "  compression_format: ''\n  compression_mode: ''\n"
        )


def _turned(R: Any) -> dict[str, float]:
    return dict(zip("xyzw", map(float, Rotation.from_matrix(R).as_quat()), strict=True))
