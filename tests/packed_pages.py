"""The arrays of a page, read as `core.js` reads them."""

import base64
import json
import re
import zlib
from typing import Any

import numpy as np

from sionna_radar.report.page.scene_data import EMPTY


def unpacked(text: str) -> tuple[dict[str, Any], bytes]:
    """Return the document of a packed text, and the bytes of its arrays."""
    content = zlib.decompress(base64.b64decode(text))
    end = 4 + int.from_bytes(content[:4], "little")
    return json.loads(content[4:end]), content[end:]


def numbers_of(page: str) -> tuple[dict[str, Any], bytes]:
    """Return the document of a page, and the bytes of its arrays."""
    found = re.search(r'<script id="numbers" type="text/plain">([^<]*)</script>', page)
    assert found
    return unpacked(found[1])


def array_of(place: dict[str, Any], arrays: bytes) -> np.ndarray:
    """Return the values of an array of an unpacked text."""
    count = int(np.prod(place["shape"]))
    numbers = np.frombuffer(arrays, f"<{place['type']}", count, place["at"]).reshape(place["shape"])
    if "step" not in place:
        return numbers.astype(np.float64)
    return np.where(numbers == EMPTY, np.nan, place["zero"] + place["step"] * numbers.astype(np.float64))
