"""Detection of city models (CityJSON, CityGML), which are rejected with a hint how to convert them.

cjio exports CityJSON as OBJ on NumPy alone; no small library turns the surfaces of CityGML into meshes, and GDAL's
drivers give them without their solids, one geometry of all levels of detail.
"""

from pathlib import Path

HEAD_BYTES = 4096
SUFFIXES = {".gml": "CityGML", ".citygml": "CityGML", ".xml": "CityGML", ".json": "CityJSON", ".jsonl": "CityJSON"}
WORDS = {"CityGML": (b"citygml", b"CityModel"), "CityJSON": (b'"CityJSON',)}
REMEDIES = {
    "CityJSON": "convert it with cjio (`cjio FILE export obj buildings.obj`)",
    "CityGML": "convert it with citygml-tools (`citygml-tools to-cityjson FILE`) and cjio "
    "(`cjio FILE.json export obj buildings.obj`)",
}
PLACED = "and give it as [[objects]], path = 'buildings.obj', centre = 'box'"


def conversion_of(path: Path) -> str | None:
    """Return what a file is and how it is converted; None if it is no city model."""
    kind = SUFFIXES.get(path.suffix.lower())
    if kind is None:
        return None
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
    return f"is {kind}; {REMEDIES[kind]}, {PLACED}" if any(word in head for word in WORDS[kind]) else None
