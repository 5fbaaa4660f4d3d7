"""What every recording says of its survey: the pulses with their poses, the scenario, the place on the map."""

import json
import platform
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.georeference import Georeference
from sionna_radar.scenario import to_toml
from sionna_radar.survey.preparation import Prepared
from sionna_radar.survey.recordings.netcdf import NetcdfFile
from sionna_radar.survey.recordings.signal_file import LAYOUT

PACKAGES = ("sionna-radar", "sionna-rt", "mitsuba", "drjit", "numpy", "scipy", "finufft")
POSES = ("true", "measured")


def new_recording(path: Path, prepared: Prepared, kind: str, title: str) -> NetcdfFile:
    """Return a new recording of a survey, with columns of its pulses that `write_pulses` fills."""
    scenario = prepared.scenario
    file = NetcdfFile(
        path,
        {
            "title": title,
            "source": f"sionna-radar {version('sionna-radar')}",
            # Undated, so that the same survey gives the same file.
            "history": "recorded while the survey was flown",
            "comment": scenario.description or "no description",
            "recording": kind,
            "layout": LAYOUT,
            "seed": scenario.seed,
            "replaced": json.dumps(prepared.custom.described()),
            "versions": json.dumps({"python": platform.python_version(), **{name: version(name) for name in PACKAGES}}),
        },
    )
    file.text("scenario", to_toml(scenario), "scenario with all values resolved, TOML")
    _add_place(file, prepared.scene.scene.georeference)
    _add_pulses(file, prepared)
    return file


def write_pulses(file: NetcdfFile, pulses: Pulses) -> None:
    """Fill in the columns of a block of pulses."""
    start = int(pulses.index[0])
    file.write("time", start, pulses.time_s)
    file.write("scan_angle", start, pulses.scan_rad)
    if pulses.scan_number is not None:
        file.write("scan_number", start, pulses.scan_number)
    if pulses.beam is not None:
        file.write("beam", start, pulses.beam)
    for name in POSES:
        pose = getattr(pulses, name)
        file.write(f"{name}_position", start, pose.position_m)
        file.write(f"{name}_velocity", start, pose.velocity_mps)
        file.write(f"{name}_rotation", start, pose.R_world_antenna)


def _add_pulses(file: NetcdfFile, prepared: Prepared) -> None:
    count, sample = len(prepared), prepared.flight.pulses(np.zeros(1, dtype=np.int64))
    file.dimension("pulse", count)
    file.dimension("axis", 3)
    file.dimension("antenna_axis", 3)

    def column(name: str, kind: type = float, dimensions: tuple[str, ...] = (), **attributes: Any) -> None:
        file.variable(name, ("pulse", *dimensions), dtype=np.dtype(kind), **attributes)

    column("time", long_name="time of the middle of the chirp since the start of the flight", units="s")
    column("scan_angle", long_name="scan angle of the antenna, zero in the middle of its sector", units="rad")
    if sample.scan_number is not None:
        column("scan_number", np.int64, long_name="scan of the antenna that the pulse belongs to, from 0")
    if sample.beam is not None:
        column("beam", np.int64, long_name="beam of the electronic scan")
    for name, whose in zip(POSES, ("true", "as the navigation system reports it"), strict=True):
        column(
            f"{name}_position",
            dimensions=("axis",),
            long_name=f"position of the antenna ({whose}): east, north, up of the local origin",
            units="m",
        )
        column(
            f"{name}_velocity",
            dimensions=("axis",),
            long_name=f"velocity of the antenna ({whose}): east, north, up",
            units="m s-1",
        )
        column(
            f"{name}_rotation",
            dimensions=("axis", "antenna_axis"),
            long_name=f"axes of the antenna ({whose}), in columns: boresight, left and up of the antenna, each east, "
            "north, up",
            units="1",
        )


def _add_place(file: NetcdfFile, place: Georeference | None) -> None:
    """Add the place of the local frame on the map, as a grid mapping."""
    if place is None:
        return
    cells = place.cells
    whole = CRS.from_wkt(place.crs_wkt)
    flat = whole.sub_crs_list[0] if whole.is_compound else whole.to_2d()
    attributes = {key: value for key, value in flat.to_cf().items() if value is not None}
    file.variable(
        "crs",
        (),
        np.int32(0),
        **attributes
        | {
            "long_name": "map coordinates are local ones plus the local origin",
            "local_frame_wkt": place.crs_wkt,
            "local_origin_m": np.array(place.origin_m),
            "cell_corner_m": None if cells is None else np.array(cells.corner_m),
            "cell_size_m": None if cells is None else np.array(cells.size_m),
        },
    )
