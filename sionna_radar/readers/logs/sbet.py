"""Smoothed best estimates of trajectory (SBET) of Applanix POSPac and others: `.out`, `.sbet`.

Records of 17 doubles, little-endian, without a header: time (s of the GPS week), latitude and longitude (rad), height
above the ellipsoid (m), three velocities in the wander frame, roll, pitch, heading of the platform and wander angle
(rad), three accelerations and three angular rates (POSPac MMS manual, "SBET format"). The true heading is that of the
platform minus the wander angle. Velocities are left out: the derivative of positions at 200 Hz is as good, and
exporters disagree on their frame.
"""

from pathlib import Path

import numpy as np

from sionna_radar.flight.log import FlightLog, Positions, attitudes_of, source_of
from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import shown

SUFFIXES = (".out", ".sbet")
FIELDS, RECORD_BYTES = 17, 136
MAX_RECORDS = 3_000_000


def read_sbet(path: Path, name: str) -> FlightLog:
    """Return the flight in an SBET; InputFileError for a file that is none."""
    label, size = f"{name} {shown(path)}", path.stat().st_size
    if size < 2 * RECORD_BYTES or size % RECORD_BYTES:
        raise InputFileError(f"{label}: {size:,} bytes are no whole records of {RECORD_BYTES}; give a whole SBET")
    if size > MAX_RECORDS * RECORD_BYTES:
        raise InputFileError(f"{label}: has more than {MAX_RECORDS:,} records; thin it, or cut it")
    records = np.fromfile(path, dtype="<f8").reshape(-1, FIELDS)
    time_s, lat, lon, height_m, roll, pitch, heading, wander = records.T[[0, 1, 2, 3, 7, 8, 9, 10]]
    with np.errstate(invalid="ignore"):
        plausible = (np.abs(lat) <= np.pi / 2) & (np.abs(lon) <= 2 * np.pi) & (np.abs(height_m) < 1e6)
        plausible &= (np.abs(records[:, 7:11]) <= 4 * np.pi).all(axis=1) & (np.abs(time_s) < 1e11)
    if not plausible.all():
        row = int(np.argmin(plausible))
        message = f"{label}: record {row + 1} holds no position or attitude in radians; give an SBET, unchanged"
        raise InputFileError(message)
    positions = Positions(
        source="lat,lon,height", time_s=time_s, place=np.column_stack([np.rad2deg(lon), np.rad2deg(lat), height_m])
    )
    euler = np.column_stack([heading - wander, pitch, roll])
    return FlightLog(
        kind="SBET",
        on_map=True,
        datum="ellipsoid",
        positions=positions,
        attitudes=attitudes_of("roll,pitch,heading - wander angle", time_s, euler, degrees=False),
        spreads=None,
        sources=(source_of("SBET", time_s),),
        notes=("heights of an SBET count from the ellipsoid of its datum",),
    )
