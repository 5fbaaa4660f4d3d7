"""What a fusion records of the files that it was made of, so that a fusion of it counts none of them twice."""

import hashlib
import json
import logging
from pathlib import Path

from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import is_file, is_folder, read_text, readable, shown

logger = logging.getLogger("sionna_radar")

# The record of a fusion, and the entry of each of its sources in it: names by the digests of files.
RECORD, MADE_OF = "fuse.json", "made_of"
DEM = "dem.tif"
REMEDY = "fuse its sources again"


def made_of(path: Path, name: str) -> dict[str, str]:
    """Return the names of the measurements that a source holds by the SHA-256 of their files.

    They are its own file, and of a fusion what was fused. Raises InputFileError for a damaged record.

    path: of a file, or of a folder of results. name: of the source.
    """
    heights = path / DEM if is_folder(path) else path
    with readable(heights, "source ="), heights.open("rb") as file:
        held = {hashlib.file_digest(file, "sha256").hexdigest(): name}
    record = heights.with_name(RECORD)
    if heights.name != DEM or not is_file(record):
        return held
    try:
        fused = json.loads(read_text(record, "source =", REMEDY))["sources"]
        recorded = [each.get(MADE_OF, {}) for each in fused]
        held |= {str(digest): str(title) for each in recorded for digest, title in each.items()}
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        message = f"source = {shown(record)} holds no sources of a fusion ({error!r:.80}); {REMEDY}"
        raise InputFileError(message) from error
    if not all(recorded):
        warning = "%s: its fuse.json does not tell the files that it was made of; give none of them again, or fuse anew"
        logger.warning(warning, name)
    return held
