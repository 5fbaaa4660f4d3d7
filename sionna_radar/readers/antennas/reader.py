"""Reading of a radiation pattern from a file of any known format, detected from its content, and its antenna."""

import csv
import logging
from pathlib import Path

from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import read_bytes, shown
from sionna_radar.radar.pattern import ProductPattern, SphericalPattern
from sionna_radar.readers.antennas.contents import PatternCuts, PatternGrid, axis_gain_db
from sionna_radar.readers.antennas.formats import (
    is_cst_source,
    is_cst_table,
    is_delimited,
    is_hfss_field,
    is_planet,
    read_cst_source,
    read_cst_table,
    read_delimited,
    read_hfss_field,
    read_planet,
)

logger = logging.getLogger("sionna_radar")

MAX_BYTES = 200_000_000
REMEDY = "give a CSV of cuts or of a grid, an MSI/PLN file, or a far field of HFSS (.csv, .ffd) or CST (.txt, .ffs)"
# Level on boresight below which the file's axes are wrong (error), or the beam squints (warning).
MIN_ON_AXIS_DB, WARNED_ON_AXIS_DB = -3.0, -0.5
# Least angular coverage of a measurement around boresight without a warning.
MIN_REACH_DEG = 60.0
FORMATS = (
    (is_cst_source, read_cst_source),
    (is_cst_table, read_cst_table),
    (is_planet, read_planet),
    (is_hfss_field, read_hfss_field),
    (is_delimited, read_delimited),
)


def read_pattern(path: Path, key: str, boresight: str = "z") -> ProductPattern | SphericalPattern:
    """Return the pattern in a file.

    Parameters
    ----------
    path, key:
        The file, and the scenario's key that names it.
    boresight:
        The axis of a file of theta and phi along which the antenna looks, "z" or "x"; "x" also for an MSI file whose
        vertical angles count from the zenith.

    Raises
    ------
    InputFileError
        It cannot be read, is of no known format, or its beam is not where the antenna looks.
    """
    # Names and comments may be in any encoding; the data are ASCII.
    text = read_bytes(path, f"{key} =", REMEDY, MAX_BYTES).decode("utf-8-sig", errors="replace")
    contents = _contents(text, f"{key} = {shown(path)}")
    try:
        pattern = contents.pattern(boresight)
    except ValueError as error:
        raise InputFileError(f"{key} = {shown(path)}: {error}") from error
    reach_deg = contents.reach_deg(boresight)
    if reach_deg < MIN_REACH_DEG:
        logger.warning(
            "%s: covers %.3g deg around boresight; nothing is sent beyond, and the directivity counts what is there "
            "(angles are in degrees)",
            key,
            reach_deg,
        )
    on_axis_db = axis_gain_db(pattern)
    if on_axis_db < MIN_ON_AXIS_DB:
        raise InputFileError(
            f"{key} = {shown(path)}: its boresight is {-on_axis_db:.1f} dB below its peak; set radar.antenna.boresight "
            f"= {'x' if boresight == 'z' else 'z'!r} if that is the axis along which it looks, or turn the pattern"
        )
    if on_axis_db < WARNED_ON_AXIS_DB:
        logger.warning("%s: the boresight is %.1f dB below the peak of the beam, which squints", key, -on_axis_db)
    return pattern


def _contents(text: str, name: str) -> PatternCuts | PatternGrid:
    for matches, parse in FORMATS:
        if matches(text):
            try:
                return parse(text)
            except (ValueError, OverflowError, csv.Error) as error:
                raise InputFileError(f"{name}: {error}") from error
    first_line = text.split("\n", 1)[0].strip()
    raise InputFileError(f"{name}: unknown pattern format; its first line is {first_line[:60]!r}; {REMEDY}")
