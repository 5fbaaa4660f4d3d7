"""Detection of city models (CityJSON, CityGML) by content; they are rejected with a hint how to convert them.

cjio exports CityJSON as OBJ on NumPy alone; no small library turns the surfaces of CityGML into meshes, and GDAL's
drivers give them without their solids, one geometry of all levels of detail.
"""

import mmap
import re
from contextlib import suppress
from pathlib import Path
from xml.parsers import expat

from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import readable, shown

# Bytes of an XML document in which elements and namespaces of CityGML are looked for.
HEAD_BYTES = 65536
# A member of a JSON object; the standard of CityJSON sets no order, so that it may be the last of the file.
CITY_TYPE = re.compile(rb'"type"\s*:\s*"CityJSON(Feature)?"')
TOKEN = re.compile(rb'"[^"\\]*(?:\\.[^"\\]*)*"|[{}\[\]]', re.DOTALL)
REMEDIES = {
    "CityJSON": "convert it with cjio (`cjio FILE export obj buildings.obj`)",
    "CityGML": "convert it with citygml-tools (`citygml-tools to-cityjson FILE`) and cjio "
    "(`cjio FILE.json export obj buildings.obj`)",
}
PLACED = "and give it as [[objects]], path = 'buildings.obj', centre = 'box'"


def refuse_city_model(path: Path, name: str) -> None:
    """Raise InputFileError, with the way to convert it, for a regular file that is CityJSON or CityGML, or unreadable.

    name: beginning of the message: what requested the file.
    """
    with readable(path, name), path.open("rb") as file:
        head = file.read(HEAD_BYTES)
        kind = None
        if head.removeprefix(b"\xef\xbb\xbf").lstrip()[:1] == b"{":
            with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
                kind = "CityJSON" if _is_city_json(content) else None
        elif _is_city_gml(head):
            kind = "CityGML"
    if kind is not None:
        raise InputFileError(f"{name} {shown(path)} is {kind}; {REMEDIES[kind]}, {PLACED}")


def _is_city_json(content: mmap.mmap) -> bool:
    """Whether the type of the outermost object of a JSON document is one of CityJSON."""
    if CITY_TYPE.search(content) is None:
        return False
    depth = 0
    for token in TOKEN.finditer(content):
        if token[0] in (b"{", b"["):
            depth += 1
        elif token[0] in (b"}", b"]"):
            depth -= 1
        elif depth == 1 and CITY_TYPE.match(content, token.start()):
            return True
    return False


def _is_city_gml(head: bytes) -> bool:
    """Whether the beginning of an XML document holds a city model, or names a namespace of CityGML."""
    names: list[str] = []
    parser = expat.ParserCreate(namespace_separator=" ")
    parser.StartNamespaceDeclHandler = lambda _prefix, uri: names.append(uri or "")
    parser.StartElementHandler = lambda name, _attributes: names.append(name)
    with suppress(expat.ExpatError, ValueError):  # another format, or damaged behind what is looked for
        parser.Parse(head, False)
    return any(name.split()[-1:] == ["CityModel"] or "/citygml/" in name for name in names)
