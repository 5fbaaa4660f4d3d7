"""What every recording holds of its survey: the pulses with their poses, the scenario and the place on the map."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from pyproj import CRS

from sionna_radar.execution.workers import versions
from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.raster import Georeference
from sionna_radar.scenario import to_toml
from sionna_radar.survey.preparation import Prepared
from sionna_radar.survey.recordings.netcdf import NetcdfFile
from sionna_radar.survey.recordings.signal_file import LAYOUT

POSES = ("true", "measured")


def new_recording(path: Path, prepared: Prepared, kind: str, title: str) -> NetcdfFile:
    """Return a new recording of a survey, with columns of its pulses that `write_pulses` fills."""
    scenario = prepared.scenario
    file = NetcdfFile(
        path,
        {
            "title": title,
            "source": f"sionna-radar {versions()['sionna-radar']}",
            # Undated, so that the same survey gives the same file.
            "history": "recorded while the survey was flown",
            "comment": scenario.description or "no description",
            "recording": kind,
            "layout": LAYOUT,
            "seed": scenario.seed,
            "replaced": json.dumps(prepared.custom.described()),
            "versions": json.dumps(versions()),
        },
    )
    file.text("scenario", to_toml(scenario), "scenario with all values resolved, TOML")
    _add_place(file, prepared.world.scene.georeference)
    _add_pulses(file, prepared)
    return file


def write_pulses(file: NetcdfFile, pulses: Pulses) -> None:
    """Fill in the columns of a block of pulses."""
    for name, values, *_ in _columns(pulses):
        file.write(name, int(pulses.index[0]), values)


def _columns(pulses: Pulses) -> Iterator[tuple[str, np.ndarray, tuple[str, ...], str, str | None]]:
    """Yield the columns of pulses: name, values, axes of each value, meaning and unit."""
    yield "time", pulses.time_s, (), "time of the middle of the chirp since the start of the flight", "s"
    yield "scan_angle", pulses.scan_rad, (), "scan angle of the antenna, zero in the middle of its sector", "rad"
    if pulses.scan_number is not None:
        yield "scan_number", pulses.scan_number, (), "scan of the antenna that the pulse belongs to, from 0", None
    if pulses.beam is not None:
        yield "beam", pulses.beam, (), "beam of the electronic scan", None
    for name, whose in zip(POSES, ("true", "as the navigation system reports it"), strict=True):
        pose, way = getattr(pulses, name), "east, north, up"
        place, velocity = (f"{what} of the antenna ({whose}): {way}" for what in ("position", "velocity"))
        yield f"{name}_position", pose.position_m, ("axis",), f"{place} of the local origin", "m"
        yield f"{name}_velocity", pose.velocity_mps, ("axis",), velocity, "m s-1"
        turn = f"axes of the antenna ({whose}), in columns: boresight, left and up of the antenna, each {way}"
        yield f"{name}_rotation", pose.R_world_antenna, ("axis", "antenna_axis"), turn, "1"


def _add_pulses(file: NetcdfFile, prepared: Prepared) -> None:
    file.dimension("pulse", len(prepared))
    file.dimension("axis", 3)
    file.dimension("antenna_axis", 3)
    for name, values, axes, meaning, units in _columns(prepared.flight.pulses(np.zeros(1, dtype=np.int64))):
        kind = np.result_type(values.dtype, np.int64)  # whole numbers and real ones have 64 bits
        file.variable(name, ("pulse", *axes), dtype=kind, long_name=meaning, units=units)


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
