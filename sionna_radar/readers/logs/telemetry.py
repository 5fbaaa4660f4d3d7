"""Telemetry logs (`.tlog`): MAVLink packets, each behind eight bytes of time (microseconds of Unix time, big-endian).

The frames are located here, since pymavlink's own reader gives some messages after damaged bytes a time 1e12 s off, and
decoded by pymavlink, which verifies their checksums. Of several vehicles the one with most
positions is used. Times are those of the vehicle (`time_boot_ms`), set to the station's clock.
"""

import struct
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path

import numpy as np
from jaxtyping import Float

from sionna_radar.flight.log import Attitudes, FlightLog, Positions, Spreads, attitudes_of, source_of, spreads_of
from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import read_bytes, shown

MAX_BYTES = 500_000_000
MAX_MESSAGES = 5_000_000
# Message numbers.
GPS_RAW, ATTITUDE, LOCAL, WORLD, ESTIMATOR = 24, 30, 32, 33, 230
NAMES = {
    GPS_RAW: "GPS_RAW_INT",
    ATTITUDE: "ATTITUDE",
    LOCAL: "LOCAL_POSITION_NED",
    WORLD: "GLOBAL_POSITION_INT",
    ESTIMATOR: "ESTIMATOR_STATUS",
}
FIELDS = {
    GPS_RAW: ("h_acc", "v_acc", "vel_acc"),
    ATTITUDE: ("time_boot_ms", "roll", "pitch", "yaw"),
    LOCAL: ("time_boot_ms", "x", "y", "z", "vx", "vy", "vz"),
    WORLD: ("time_boot_ms", "lat", "lon", "alt", "vx", "vy", "vz"),
    ESTIMATOR: ("pos_horiz_accuracy", "pos_vert_accuracy"),
}
V1, V2 = 0xFE, 0xFD
SIGNED = 0x01
# Smaller backward steps of the vehicle's clock are reordered messages.
MIN_RESTART_S = 1.0
Columns = Mapping[str, Float[np.ndarray, " n"]]


def frames(content: bytes) -> Iterator[tuple[int, int, int, bytes]]:
    """Yield time (microseconds), system, number and bytes of each frame; damaged bytes are skipped."""
    offset, size = 0, len(content)
    while offset + 16 <= size:
        start = content[offset + 8]
        if start == V1:
            length, head = content[offset + 9] + 8, 6
            system, number = content[offset + 11], content[offset + 13]
        elif start == V2:
            length, head = content[offset + 9] + 12 + 13 * (content[offset + 10] & SIGNED), 10
            system, number = content[offset + 13], int.from_bytes(content[offset + 15 : offset + 18], "little")
        else:
            offset += 1
            continue
        end = offset + 8 + length
        # Accept a frame if it is followed by another one or the end of the file.
        if end > size or (end + 8 < size and content[end + 8] not in (V1, V2)) or length <= head:
            offset += 1
            continue
        yield struct.unpack_from(">Q", content, offset)[0], system, number, content[offset + 8 : end]
        offset = end


def read_telemetry(path: Path, name: str) -> FlightLog:
    """Return the flight in a telemetry log; raises InputFileError without MAVLink, or without positions."""
    label = f"{name} {shown(path)}"
    content = read_bytes(path, name, "give a telemetry log", MAX_BYTES)
    tables, notes = _tables(content, label)
    positions, on_map = _positions(tables, label)
    return FlightLog(
        kind="MAVLink telemetry",
        on_map=on_map,
        datum="mean sea level" if on_map else "take-off",
        positions=positions,
        attitudes=_attitudes(tables),
        spreads=_spreads(tables),
        sources=tuple(source_of(NAMES[number], table["time_s"]) for number, table in sorted(tables.items())),
        notes=notes,
    )


def _tables(content: bytes, label: str) -> tuple[dict[int, Columns], tuple[str, ...]]:
    from pymavlink.dialects.v20 import common

    decoder = common.MAVLink(None)
    decoder.robust_parsing = False
    rows: dict[tuple[int, int], list[list[float]]] = {}
    damaged = count = 0
    # pymavlink may print remarks about damaged messages.
    with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
        for time_us, system, number, frame in frames(content):
            if number not in NAMES:
                continue
            count += 1
            if count > MAX_MESSAGES:
                raise InputFileError(f"{label}: has more than {MAX_MESSAGES:,} messages; cut it")
            try:
                message = decoder.decode(bytearray(frame))
                row = [time_us * 1e-6, *(float(getattr(message, field)) for field in FIELDS[number])]
            except Exception:  # a wrong checksum; pymavlink raises undocumented types
                damaged += 1
            else:
                rows.setdefault((system, number), []).append(row)
    if not rows:
        message = f"{label}: holds no MAVLink position or attitude; give a telemetry log (.tlog) of a flight"
        raise InputFileError(message)
    return _of_one_vehicle(rows, damaged)


def _of_one_vehicle(
    rows: Mapping[tuple[int, int], list[list[float]]], damaged: int
) -> tuple[dict[int, Columns], tuple[str, ...]]:
    placed = Counter({system: len(messages) for (system, number), messages in rows.items() if number in (WORLD, LOCAL)})
    systems = sorted({system for system, _ in rows})
    chosen = placed.most_common(1)[0][0] if placed else systems[0]
    notes = [f"{damaged:,} messages are damaged, and left out"] if damaged else []
    if len(systems) > 1:
        notes.append(f"{len(systems)} vehicles or stations; number {chosen} is used")
    tables: dict[int, Columns] = {}
    for (system, number), messages in rows.items():
        if system == chosen:
            values = np.array(messages).T
            tables[number] = dict(zip(("time_s", *FIELDS[number]), values, strict=True))
    return _on_one_clock(tables, notes)


def _on_one_clock(tables: dict[int, Columns], notes: list[str]) -> tuple[dict[int, Columns], tuple[str, ...]]:
    """Return messages timed by the vehicle's clock, each run offset to the station's by the median difference."""
    boot = [table for table in tables.values() if "time_boot_ms" in table]
    if not boot:
        return tables, tuple(notes)
    received_s, boot_s = (
        np.concatenate(parts)
        for parts in ([table["time_s"] for table in boot], [table["time_boot_ms"] * 1e-3 for table in boot])
    )
    order = np.argsort(received_s, kind="stable")
    received_s, boot_s = received_s[order], boot_s[order]
    restarts = np.flatnonzero(np.diff(boot_s) < -MIN_RESTART_S) + 1
    if len(restarts):
        notes.append(
            f"the vehicle's clock restarted ({len(restarts)} times); the time in between is the ground station's"
        )
    starts_s = np.concatenate([[-np.inf], received_s[restarts]])
    offsets_s = np.array([np.median(part) for part in np.split(received_s - boot_s, restarts)])
    clocked: dict[int, Columns] = {}
    for number, table in tables.items():
        if "time_boot_ms" in table:
            run = np.searchsorted(starts_s, table["time_s"], side="right") - 1
            table = {**table, "time_s": table["time_boot_ms"] * 1e-3 + offsets_s[run]}
        clocked[number] = table
    return clocked, tuple(notes)


def _positions(tables: Mapping[int, Columns], label: str) -> tuple[Positions, bool]:
    world, local = tables.get(WORLD), tables.get(LOCAL)
    if world is not None:
        valid = (world["lat"] != 0) | (world["lon"] != 0)
        position = np.column_stack([world["lon"] * 1e-7, world["lat"] * 1e-7, world["alt"] * 1e-3])
        velocity = np.column_stack([world["vy"], world["vx"], -world["vz"]]) * 0.01
        if valid.sum() >= 2:
            positions = Positions(source=NAMES[WORLD], time_s=world["time_s"], place=position, velocity_mps=velocity)
            return positions.rows(valid), True
    if local is not None and len(local["x"]) >= 2:
        position = np.column_stack([local["y"], local["x"], -local["z"]])
        velocity = np.column_stack([local["vy"], local["vx"], -local["vz"]])
        return Positions(source=NAMES[LOCAL], time_s=local["time_s"], place=position, velocity_mps=velocity), False
    message = f"{label}: has no positions ({NAMES[WORLD]}, {NAMES[LOCAL]}); give a log of a flight with a position"
    raise InputFileError(message)


def _attitudes(tables: Mapping[int, Columns]) -> Attitudes | None:
    table = tables.get(ATTITUDE)
    if table is None:
        return None
    euler = np.column_stack([table[key] for key in ("yaw", "pitch", "roll")])
    return attitudes_of(NAMES[ATTITUDE], table["time_s"], euler, degrees=False)


def _spreads(tables: Mapping[int, Columns]) -> Spreads | None:
    """Return the accuracies stated by the filter (PX4), or else by the receiver."""
    table = tables.get(ESTIMATOR)
    if table is not None and np.any(table["pos_horiz_accuracy"] > 0):
        horizontal = table["pos_horiz_accuracy"] / np.sqrt(2)
        return spreads_of(
            NAMES[ESTIMATOR], table["time_s"], np.column_stack([horizontal, horizontal, table["pos_vert_accuracy"]])
        )
    table = tables.get(GPS_RAW)
    if table is not None and np.any(table["h_acc"] > 0):
        stated = table["h_acc"] > 0
        horizontal, vertical, speed = (table[key][stated] * 1e-3 for key in ("h_acc", "v_acc", "vel_acc"))
        position = np.column_stack([horizontal / np.sqrt(2), horizontal / np.sqrt(2), vertical])
        return spreads_of(NAMES[GPS_RAW], table["time_s"][stated], position, np.tile(speed[:, None], (1, 3)))
    return None
