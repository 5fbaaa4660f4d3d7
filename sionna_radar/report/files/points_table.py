"""The points of a survey as a plain table: CSV, or Parquet where pyarrow is installed.

Column names carry units; a few thousand rows at a time are in memory. Positions are in map coordinates (`easting_m`,
`northing_m`, `height_m`) if georeferenced, otherwise in local metres (`east_m`, `north_m`, `up_m`).
"""

from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from sionna_radar.foundation.errors import OutputError
from sionna_radar.foundation.raster import Georeference
from sionna_radar.mapping.points import Points

ROWS_AT_ONCE = 20_000
ROWS_OF_A_GROUP = 100_000
ON_MAP = ("easting_m", "northing_m", "height_m")
LOCAL = ("east_m", "north_m", "up_m")
# Tenths of a millimetre, microseconds, thousandths of a decibel: finer than the accuracy of the values.
FORMATS = {"pulse": "%d", "echo": "%d", "time_s": "%.6f", "snr_db": "%.3f", "power_w": "%.6e", "power": "%.6e"}
LENGTH_FORMAT = "%.4f"
MEANING = {
    "pulse": "index of the pulse in the survey",
    "echo": "number of the echo in its pulse, 0 is the nearest",
    "time_s": "middle of the chirp, since the start of the flight",
    "range_m": "slant range, corrected for Doppler",
    "range_sigma_m": "standard deviation of the range",
    "across_sigma_m": "standard deviation of the position across the ray, in its vertical plane",
    "snr_db": "of the echo's strongest cell over the noise",
    "power_w": "received, in the echo's strongest cell",
}


def columns_of(
    points: Points, time_s: Float[np.ndarray, " pulse"], georeference: Georeference | None, rows: slice = slice(None)
) -> dict[str, np.ndarray]:
    """Return the columns of some points by their names, in the order of the files.

    Parameters
    ----------
    points:
        Points in the local frame.
    time_s:
        Times of all pulses, by their index.
    georeference:
        Georeference of the local frame; None keeps local coordinates.
    rows:
        Selected points.

    """
    origin = np.array(georeference.origin_m if georeference else (0.0, 0.0, 0.0))
    axes = ON_MAP if georeference else LOCAL
    pulse = points.pulse[rows]
    place, radar = points.position_m[rows] + origin, points.origin_m[rows] + origin
    return {
        "pulse": pulse,
        "echo": points.number[rows],
        "time_s": time_s[pulse],
        **dict(zip(axes, place.T, strict=True)),
        "range_m": points.range_m[rows],
        "range_sigma_m": points.range_sigma_m[rows],
        **({} if points.across_sigma_m is None else {"across_sigma_m": points.across_sigma_m[rows]}),
        "snr_db": points.snr_db[rows],
        "power_w": points.power[rows],
        **dict(zip([f"radar_{axis}" for axis in axes], radar.T, strict=True)),
    }


def write_points_csv(
    path: Path, points: Points, time_s: Float[np.ndarray, " pulse"], georeference: Georeference | None
) -> None:
    """Write points as CSV: a header, and lengths to a tenth of a millimetre; see `columns_of` for the arguments."""
    write_csv(path, len(points), lambda rows: columns_of(points, time_s, georeference, rows))


def write_csv(path: Path, count: int, columns: Callable[[slice], dict[str, np.ndarray]]) -> None:
    """Write columns as CSV, in blocks of rows."""
    names = list(columns(slice(0, 0)))
    line = ",".join(FORMATS.get(name, LENGTH_FORMAT) for name in names) + "\n"
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(names) + "\n")
        for rows in _parts(count, ROWS_AT_ONCE):
            file.write("".join([line % row for row in zip(*(c.tolist() for c in columns(rows).values()), strict=True)]))


def write_points_parquet(
    path: Path, points: Points, time_s: Float[np.ndarray, " pulse"], georeference: Georeference | None
) -> None:
    """Write points as Parquet, losslessly, with the CRS in the file's metadata and meanings in the columns'.

    See `columns_of` for the arguments. Raises OutputError without pyarrow.
    """
    check_parquet()
    import pyarrow as pa
    from pyarrow.parquet import ParquetWriter

    empty = columns_of(points, time_s, georeference, slice(0, 0))
    fields = [_field(pa, name, column) for name, column in empty.items()]
    schema = pa.schema(fields, metadata={"crs": georeference.crs_wkt if georeference else "local"})
    with ParquetWriter(path, schema, compression="zstd") as file:
        for rows in _parts(len(points), ROWS_OF_A_GROUP):
            columns = columns_of(points, time_s, georeference, rows)
            file.write_table(pa.table(list(columns.values()), schema=schema))


def check_parquet(name: str = "points.parquet") -> None:
    """Raise OutputError, before the flight, if Parquet cannot be written."""
    if find_spec("pyarrow") is None:
        message = f"{name} needs pyarrow; install sionna-radar[parquet], or write CSV with --{Path(name).stem} csv"
        raise OutputError(message)


def _field(pa: Any, name: str, column: np.ndarray) -> Any:
    meaning = MEANING.get(name, "position, on the map if there is one")
    return pa.field(name, pa.from_numpy_dtype(column.dtype), metadata={"description": meaning})


def _parts(count: int, size: int) -> Iterator[slice]:
    return (slice(start, min(start + size, count)) for start in range(0, count, size))
