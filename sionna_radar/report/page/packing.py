"""Numbers inside a page: one JSON document with arrays as bytes beside it, compressed, as one word of base64.

    length of the JSON (4 bytes, little-endian) | JSON, padded to 8 bytes | arrays, each at a multiple of 8 bytes

An array stands in the JSON as {"at": offset, "type": "u2", "shape": [...], "step": 0.001, "zero": 12.5}; its values are
`zero + step * number`, and the largest number stands for NaN. Nothing in base64 can end a script element, so that no
text inside needs escaping; `core.js` is the reader.
"""

import base64
import json
import zlib
from typing import Any

import numpy as np
from jaxtyping import Float, Inexact, Int

from sionna_radar.report.folder import without_nan

EMPTY = 65_535
# The first level: higher ones shorten a page by a tenth and take three times as long.
LEVEL = 1


class Pack:
    """The arrays of a page."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._size = 0

    def rounded(self, values: Inexact[np.ndarray, "..."], step: float) -> dict[str, Any]:
        """Return the place of values rounded to a step, in 16 bits; where they span too much the step is coarser."""
        values = np.asarray(values, dtype=np.float64)
        known = np.isfinite(values)
        low, high = (float(values[known].min()), float(values[known].max())) if known.any() else (0.0, 0.0)
        step = max(step, (high - low) / (EMPTY - 1))
        numbers = np.full(values.shape, EMPTY, dtype="<u2")
        numbers[known] = np.round((values[known] - low) / step)
        return {**self._keep(numbers, "u2"), "step": step, "zero": low}

    def exact(self, values: Float[np.ndarray, "..."]) -> dict[str, Any]:
        """Return the place of values as 32-bit floats."""
        return self._keep(np.asarray(values, dtype="<f4"), "f4")

    def whole(self, values: Int[np.ndarray, "..."]) -> dict[str, Any]:
        """Return the place of whole numbers."""
        return self._keep(np.asarray(values, dtype="<i4"), "i4")

    def _keep(self, array: np.ndarray, kind: str) -> dict[str, Any]:
        content = np.ascontiguousarray(array).tobytes()
        place = {"at": self._size, "type": kind, "shape": list(array.shape)}
        padding = -len(content) % 8
        self._parts.append(content + b"\0" * padding)
        self._size += len(content) + padding
        return place

    def text(self, document: dict[str, Any]) -> str:
        """Return a document, in which the places of arrays stand, with these arrays."""
        head = json.dumps(without_nan(document), allow_nan=False, separators=(",", ":")).encode("utf-8")
        head += b" " * (-(len(head) + 4) % 8)
        return compressed(len(head).to_bytes(4, "little") + head + b"".join(self._parts))


def compressed(content: bytes) -> str:
    """Return bytes as compressed base64."""
    return base64.b64encode(zlib.compress(content, LEVEL)).decode("ascii")


def unpacked(text: str) -> tuple[dict[str, Any], dict[int, bytes]]:
    """Return the document of a packed text, and its arrays by their offsets: what `core.js` reads."""
    content = zlib.decompress(base64.b64decode(text))
    length = int.from_bytes(content[:4], "little")
    document = json.loads(content[4 : 4 + length])
    body = content[4 + length :]
    return document, {place["at"]: body[place["at"] :] for place in _places(document)}


def array_of(place: dict[str, Any], arrays: dict[int, bytes]) -> Float[np.ndarray, "..."]:
    """Return the values of an array of an unpacked text."""
    count = int(np.prod(place["shape"]))
    numbers = np.frombuffer(arrays[place["at"]], dtype=f"<{place['type']}", count=count).reshape(place["shape"])
    if "step" not in place:
        return numbers.astype(np.float64)
    return np.where(numbers == EMPTY, np.nan, place["zero"] + place["step"] * numbers.astype(np.float64))


def _places(node: Any) -> list[dict[str, Any]]:
    if isinstance(node, dict):
        if {"at", "type", "shape"} <= node.keys():
            return [node]
        return [place for entry in node.values() for place in _places(entry)]
    return [place for entry in node for place in _places(entry)] if isinstance(node, list) else []
