"""ArduPilot's DataFlash logs (`.bin`).

A file describes its own messages: FMT gives the type, length, name, format characters and columns of each. Layout and
characters as in ArduPilot's AP_Logger (LogStructure.h). This is a reader of our own: pymavlink 2.4 rejects a whole log
for one FMT with an unknown character, and reads nothing from one with a message of zero length; the tests compare both.
"""

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from sionna_radar.flight.log import (
    Attitudes,
    FlightLog,
    Positions,
    Spreads,
    attitudes_of,
    innovations_of,
    source_of,
    spreads_of,
)
from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import read_bytes, shown

MAX_BYTES = 1_000_000_000
MAX_MESSAGES = 20_000_000
MAGIC = b"\xa3\x95"
FMT, FMT_LENGTH = 0x80, 89
# Characters of a format: NumPy's type, and the factor to the unit (degrees for L).
CHARACTERS: dict[str, tuple[str, float]] = {
    "a": ("V64", 1.0), "b": ("<i1", 1.0), "B": ("<u1", 1.0), "h": ("<i2", 1.0), "H": ("<u2", 1.0), "i": ("<i4", 1.0),
    "I": ("<u4", 1.0), "f": ("<f4", 1.0), "d": ("<f8", 1.0), "n": ("S4", 1.0), "N": ("S16", 1.0), "Z": ("S64", 1.0),
    "c": ("<i2", 0.01), "C": ("<u2", 0.01), "e": ("<i4", 0.01), "E": ("<u4", 0.01), "L": ("<i4", 1e-7),
    "M": ("<u1", 1.0), "q": ("<i8", 1.0), "Q": ("<u8", 1.0), "g": ("<f2", 1.0),
}  # fmt: skip
# Messages read from a log.
WANTED = ("POS", "GPS", "AHR2", "ATT", "XKF1", "NKF1", "EKF1", "XKF3", "NKF3", "EKF3", "GPA", "XKQ")
MIN_FIX = 3
Columns = dict[str, Float[np.ndarray, " n"]]


@dataclass(frozen=True)
class _Format:
    name: str
    length: int
    types: np.dtype
    scales: dict[str, float]


def read_dataflash(path: Path, name: str) -> FlightLog:
    """Return the flight in a DataFlash log; raises InputFileError for any other file, or one without positions."""
    label = f"{name} {shown(path)}"
    content = read_bytes(path, name, "give a DataFlash log", MAX_BYTES)
    tables, skipped = _tables(content, label)
    positions = _positions(tables, label)
    attitudes, spreads = _attitudes(tables), _spreads(tables)
    return FlightLog(
        kind="ArduPilot DataFlash",
        on_map=True,
        datum="mean sea level",
        positions=positions,
        attitudes=attitudes,
        spreads=spreads,
        sources=tuple(source_of(key, table["TimeUS"] * 1e-6) for key, table in tables.items()),
        notes=(f"{skipped:,} bytes between messages are damaged, and skipped",) if skipped else (),
    )


def _tables(content: bytes, label: str) -> tuple[dict[str, Columns], int]:
    """Return the messages of `WANTED` as columns, and the number of bytes outside messages."""
    formats = {FMT: _Format("FMT", FMT_LENGTH, np.dtype([]), {})}
    starts: dict[int, list[int]] = {}
    offset, size, skipped, count = 0, len(content), 0, 0
    while offset + 3 <= size:
        form = formats.get(content[offset + 2]) if content.startswith(MAGIC, offset) else None
        if form is None or offset + form.length > size:
            next_offset = content.find(MAGIC, offset + 1)
            skipped += (size if next_offset < 0 else next_offset) - offset
            if next_offset < 0:
                break
            offset = next_offset
            continue
        kind = content[offset + 2]
        if kind == FMT:
            described = _format(content[offset + 3 : offset + FMT_LENGTH])
            if described is not None and described[0] != FMT and described[0] not in starts:
                formats[described[0]] = described[1]
        elif form.name in WANTED:
            starts.setdefault(kind, []).append(offset)
        offset += form.length
        count += 1
        if count > MAX_MESSAGES:
            raise InputFileError(f"{label}: has more than {MAX_MESSAGES:,} messages; cut it")
    if not count:
        raise InputFileError(f"{label}: holds no message of a DataFlash log; give a .bin of ArduPilot")
    return {
        formats[kind].name: _columns(content, formats[kind], offsets)
        for kind, offsets in starts.items()
        if {"TimeUS", "TimeMS"} & set(formats[kind].scales)
    }, skipped


def _format(body: bytes) -> tuple[int, _Format] | None:
    """Return a message type and its format; None if malformed."""
    kind, length, name, characters, columns = struct.unpack("<BB4s16s64s", body)
    text = [field.split(b"\0")[0].decode("ascii", "replace") for field in (name, characters, columns)]
    keys = text[2].split(",")
    if not all(keys) or len(keys) != len(text[1]) or len(set(keys)) != len(keys) or not set(text[1]) <= set(CHARACTERS):
        types, scales = np.dtype([]), {}
    else:
        types = np.dtype([(key, CHARACTERS[c][0]) for key, c in zip(keys, text[1], strict=True)])
        scales = {key: CHARACTERS[c][1] for key, c in zip(keys, text[1], strict=True) if c not in "anNZ"}
        if types.itemsize + 3 != length:
            types, scales = np.dtype([]), {}
    # A length within the header would loop forever.
    return (kind, _Format(text[0], length, types, scales)) if length > 3 else None


def _columns(content: bytes, form: _Format, offsets: list[int]) -> Columns:
    rows = np.frombuffer(b"".join(content[offset + 3 : offset + form.length] for offset in offsets), dtype=form.types)
    with np.errstate(invalid="ignore"):  # converting a damaged NaN warns
        columns = {key: rows[key].astype(np.float64) * scale for key, scale in form.scales.items()}
    if "TimeUS" not in columns:
        # Before 2015; TimeMS of a GPS is the week's, and T the autopilot's.
        columns["TimeUS"] = columns["T" if form.name == "GPS" and "T" in columns else "TimeMS"] * 1000.0
    # Use the first of several receivers or filters.
    instance = next((columns[key] for key in ("I", "C") if key in columns and form.name != "ATT"), None)
    if instance is None or not len(instance):
        return columns
    primary = instance == instance.min()
    return {key: column[primary] for key, column in columns.items()}


def _positions(tables: Mapping[str, Columns], label: str) -> Positions:
    for name in ("POS", "GPS", "AHR2"):
        table = tables.get(name)
        if table is None or not {"Lat", "Lng", "Alt"} <= set(table):
            continue
        valid = (table["Lat"] != 0) | (table["Lng"] != 0)
        if name == "GPS" and "Status" in table:
            valid &= table["Status"] >= MIN_FIX
        if valid.sum() < 2:
            continue
        time_s = table["TimeUS"][valid] * 1e-6
        position = np.column_stack([table[key][valid] for key in ("Lng", "Lat", "Alt")])
        return Positions(
            source=name, time_s=time_s, place=position, velocity_mps=_velocity(tables, time_s, name, valid)
        )
    raise InputFileError(f"{label}: has no positions (POS, GPS or AHR2); give a log of a flight with a position")


def _velocity(
    tables: Mapping[str, Columns], time_s: Float[np.ndarray, " n"], name: str, valid: Bool[np.ndarray, " m"]
) -> Float[np.ndarray, "n 3"] | None:
    """Return the filter's velocities at the times of positions, or the receiver's own with its own positions."""
    for filtered in ("XKF1", "NKF1", "EKF1"):
        table = tables.get(filtered)
        if name != "GPS" and table is not None and {"VN", "VE", "VD"} <= set(table) and len(table["VN"]) > 1:
            order = np.argsort(table["TimeUS"], kind="stable")
            clock = table["TimeUS"][order] * 1e-6
            if clock[0] <= time_s.min() + 1.0 and clock[-1] >= time_s.max() - 1.0:
                signs = (("VE", 1.0), ("VN", 1.0), ("VD", -1.0))
                return np.column_stack([s * np.interp(time_s, clock, table[key][order]) for key, s in signs])
    gps = tables.get("GPS", {})
    if name == "GPS" and {"Spd", "GCrs", "VZ"} <= set(gps):
        course, speed = np.deg2rad(gps["GCrs"][valid]), gps["Spd"][valid]
        return np.column_stack([speed * np.sin(course), speed * np.cos(course), -gps["VZ"][valid]])
    return None


def _attitudes(tables: Mapping[str, Columns]) -> Attitudes | None:
    for name in ("ATT", "XKF1", "NKF1", "EKF1", "AHR2"):
        table = tables.get(name)
        if table is not None and {"Roll", "Pitch", "Yaw"} <= set(table) and len(table["Roll"]):
            euler = np.column_stack([table[key] for key in ("Yaw", "Pitch", "Roll")])
            attitudes = attitudes_of(name, table["TimeUS"] * 1e-6, euler, degrees=True)
            if attitudes is not None:
                return attitudes
    return None


def _spreads(tables: Mapping[str, Columns]) -> Spreads | None:
    """Return the running RMS of the filter's innovations, else the receiver's stated accuracies; None without either.

    XKF4 and similar messages hold ratios of innovations to gates, not lengths, and are ignored.
    """
    for name in ("XKF3", "NKF3", "EKF3"):
        table = tables.get(name)
        keys = ("IPE", "IPN", "IPD", "IVE", "IVN", "IVD")
        if table is not None and set(keys) <= set(table) and len(table["IPE"]) > 1:
            return innovations_of(f"{name} innovations", table["TimeUS"] * 1e-6, table, keys)
    table = tables.get("GPA", {})
    if {"HAcc", "VAcc", "SAcc"} <= set(table) and len(table["HAcc"]) > 1:
        # A horizontal figure combines both axes.
        across = table["HAcc"] / np.sqrt(2)
        position = np.column_stack([across, across, table["VAcc"]])
        return spreads_of("GPA", table["TimeUS"] * 1e-6, position, np.tile(table["SAcc"][:, None], (1, 3)))
    return None
