"""Inputs that no survey has, drawn by hypothesis: scenarios, rasters, tables, patterns and command lines."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import numpy as np
import rasterio
import tomli_w
from hypothesis import strategies as st
from rasterio import Affine
from typer.main import get_command

from beams import make_antenna
from pattern_files import WRITERS
from scenario_keys import keys_of
from sionna_radar.cli.app import app
from sionna_radar.foundation.input_file import parse_toml
from sionna_radar.scenario import Scenario, parse_scenario
from sionna_radar.scenario.terrain import RasterTerrain
from surveys import SMALL

TABLES = (("terrain",), ("platform",), ("radar",))
KEYS = sorted(".".join(key) for key in keys_of(Scenario) if key not in TABLES)
RASTER_KEYS = [f"terrain.{name}" for name in RasterTerrain.model_fields if name != "path"]
WORDS = ("", "x", "none", "\0", "[/x]", "ä" * 200, "flat", "hills", "fractal", "all", "refined", "smooth", "stepped",
         "linear", "triangular", "persistent", "per_pulse", "lidar", "gamma", "path_solver", "9" * 50)  # fmt: skip
NUMBERS = (
    0, 1, -1, 2, 7, 0.5, -0.0, 1e-300, 5e-324, 1e-15, 1e-9, 1e-3, 30.0, 89.9, 90, 180, 360.0, 1e3, 1e5, 1e9, 1e15, 1e30,
    1e38, 1e300, 2**20, 2**31, 2**53, 2**63 - 1, math.nan, math.inf, -math.inf,
)  # fmt: skip
FACTORS = (1e-6, 1e-3, 0.1, 0.5, 2.0, 10.0, 1e3, 1e6)


@dataclass(frozen=True)
class HardInput:
    """A command line, and the files that it reads by their names."""

    arguments: list[str]
    files: dict[str, bytes | Callable[[], bytes]] = field(default_factory=dict)

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:
        # Whole files would be too long for Hypothesis, which prints how to draw them again.
        starts = {
            name: content[:300] if isinstance(content, bytes) else content for name, content in self.files.items()
        }
        printer.text(f"HardInput({self.arguments!r}, {starts!r})")


def _default(base: Scenario, key: str) -> object:
    node: object = base
    for name in key.split("."):
        node = getattr(node, name, None)
    return node


def _put(data: dict, key: str, value: object) -> None:
    *tables, last = key.split(".")
    for name in tables:
        data = data.setdefault(name, {})
        if not isinstance(data, dict):
            return
    data[last] = value


# Read once, and what that imports loaded with it: hypothesis wants nothing random where it draws.
DEFAULTS = {key: _default(parse_scenario(parse_toml(SMALL)), key) for key in KEYS}


def _fitting() -> dict[str, object]:
    """Return the keys of `SMALL` that hold a number ("whole" or "real"), or one of some words or truth values."""
    base, found = parse_scenario(parse_toml(SMALL)), {}
    for key in KEYS:
        *tables, name = key.split(".")
        node: object = base
        for table in tables:
            node = getattr(node, table, None)
        field = getattr(type(node), "model_fields", {}).get(name)
        if field is None:
            continue
        kinds = [field.annotation, *get_args(field.annotation)]
        words = [word for kind in kinds if get_origin(kind) is Literal for word in get_args(kind)]
        if words or bool in kinds:
            found[key] = words or [True, False]
        elif float in kinds or int in kinds:
            found[key] = "real" if float in kinds else "whole"
    return found


FITTING = _fitting()
numbers = st.sampled_from(NUMBERS) | st.floats() | st.integers(-(2**63), 2**63 - 1)
plain = numbers | st.sampled_from(WORDS) | st.booleans() | st.text(max_size=8)
values = st.recursive(
    plain,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(("a", "kind", "model", "path")), inner),
    max_leaves=5,
)


@st.composite
def key_values(draw: st.DrawFn, keys: Sequence[str] = KEYS) -> tuple[str, object]:
    """A key of a scenario with anything in it."""
    return draw(st.sampled_from(keys)), draw(values)


@st.composite
def fitting_values(draw: st.DrawFn) -> tuple[str, object]:
    """A key of a scenario with a value of its kind: another word, or its number moved by some orders of magnitude."""
    key = draw(st.sampled_from(sorted(FITTING)))
    kind, default = FITTING[key], DEFAULTS[key]
    if not isinstance(kind, str):
        return key, draw(st.sampled_from(kind))
    start = default or draw(st.sampled_from((1, 10)))
    moved = start * draw(st.sampled_from(FACTORS))
    return key, max(int(moved), 1) if kind == "whole" else float(moved)


@st.composite
def scenarios(draw: st.DrawFn) -> HardInput:
    """A survey of half a second, some of its keys changed."""
    data = parse_toml(SMALL)
    data["platform"]["length_m"] = 4.0
    if draw(st.booleans()):
        data["terrain"]["kind"] = draw(st.sampled_from(("hills", "fractal")))
    changed = draw(st.lists(fitting_values(), max_size=3)) + draw(
        st.lists(key_values(), max_size=draw(st.integers(0, 1)))
    )
    for key, value in changed:
        _put(data, key, value)
    return HardInput(["run", "hard.toml", "--no-report"], {"hard.toml": _toml(data)})


HEIGHTS = {
    "level": lambda x, _: 0 * x + 10,
    "waves": lambda x, noise: 3 * np.sin(x) + noise,
    "steep": lambda x, _: 1e3 * x,
    "huge": lambda _, noise: 1e30 * noise,
    "below": lambda _, noise: noise - 1e4,
    "holes": lambda _, noise: np.where(noise > 0, np.nan, noise),
    "infinite": lambda _, noise: np.where(noise > 1, np.inf, noise),
    "nothing": lambda x, _: np.nan * x,
    "mark": lambda _, noise: np.where(noise > 0.5, -9999.0, noise),
}


@st.composite
def rasters(draw: st.DrawFn) -> HardInput:
    """A survey over a GeoTIFF of odd size, place, type or heights, or with some of its bytes changed."""
    dtype = draw(st.sampled_from(("float32", "float64", "int16", "uint8", "int32")))
    rows, columns = (draw(st.just(60) | st.just(100) | st.integers(1, 60)) for _ in range(2))
    step = draw(st.sampled_from((5.0, 5.0, 5.0, 20.0, 1.0, 1e-6, 1e7, 0.0001)))
    shear = draw(st.sampled_from((0.0, 0.0, 0.0, 1.0, 5.0)))
    west, north = draw(
        st.sampled_from((*2 * ((690_000.0, 5_330_000.0),), (11.5, 48.1), (-5.0 * columns, 100.0), (1e12, 0.0)))
    )
    profile = {
        "driver": "GTiff",
        "count": draw(st.sampled_from((1, 1, 1, 3))),
        "dtype": dtype,
        "height": rows,
        "width": columns,
        "transform": Affine(step, shear, west, shear, -step, north),
        "crs": draw(
            st.sampled_from(("EPSG:32632", "EPSG:32632", "EPSG:25832", "EPSG:4326", "EPSG:3857", "EPSG:2263", None))
        ),
        "nodata": draw(st.sampled_from((None, -9999.0, 0.0))) if dtype != "uint8" else None,
    }
    kind, seed, change = draw(st.sampled_from(sorted(HEIGHTS))), draw(st.integers(0, 99)), draw(changes())
    data = parse_toml(SMALL)
    data["platform"] |= {"length_m": 4.0, "altitude_m": draw(st.sampled_from((50.0, 50.0, 5.0)))}
    data["terrain"] = {"kind": "raster", "path": "hard.tif"}
    for key, value in draw(st.lists(key_values(RASTER_KEYS), max_size=1)):
        _put(data, key, value)
    # Written by the test: hypothesis wants nothing random where it draws, and GDAL names its files at random.
    files = {"hard.toml": _toml(data), "hard.tif": lambda: change(_raster(profile, kind, seed))}
    return HardInput(["run", "hard.toml", "--no-report"], files)


def _raster(profile: dict, kind: str, seed: int) -> bytes:
    rows, columns = profile["height"], profile["width"]
    noise = np.random.default_rng(seed).normal(size=(rows, columns))
    with np.errstate(all="ignore"):
        heights = HEIGHTS[kind](np.arange(columns) + 0 * noise, noise)
        if profile["dtype"][0] != "f":
            heights = np.nan_to_num(heights)
        heights = heights.astype(profile["dtype"])
    with rasterio.MemoryFile() as memory:
        with memory.open(**profile) as file:
            for band in range(1, profile["count"] + 1):
                file.write(heights, band)
        return memory.read()


@st.composite
def changes(draw: st.DrawFn) -> Callable[[bytes], bytes]:
    """What leaves a content as it is, cuts it short, or changes some of its bytes."""
    kind, cut = draw(st.integers(0, 5)), draw(st.floats(0, 1))
    places = draw(st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), min_size=1, max_size=8))

    def changed(content: bytes) -> bytes:
        if kind == 0:
            return content[: int(cut * len(content))]
        if kind > 1 or not content:
            return content
        found = bytearray(content)
        for place, byte in places:
            found[int(place * len(found))] = byte
        return bytes(found)

    return changed


def _toml(data: dict) -> bytes:
    return tomli_w.dumps(data).encode("utf-8", "surrogatepass")


@st.composite
def tables(draw: st.DrawFn) -> HardInput:
    """A study of a table of settings."""
    keys = draw(st.lists(st.sampled_from(KEYS) | st.text(max_size=8), min_size=1, max_size=3))
    cells = st.sampled_from(
        ("", "none", "1", "2.5", "-1", "nan", "inf", "1e300", "[1, 2]", "[", "x", '"', "true", "{}")
    )
    rows = draw(st.lists(st.lists(cells | st.text(max_size=5), min_size=1, max_size=3), max_size=3))
    text = "\n".join(",".join(line) for line in [keys, *rows]).encode("utf-8", "surrogatepass")
    return HardInput(["sweep", "small.toml", "--table", "hard.csv"], {"hard.csv": draw(changes())(text)})


@st.composite
def patterns(draw: st.DrawFn) -> HardInput:
    """A survey with a measured antenna whose file has bytes changed."""
    name, content = draw(st.sampled_from(sorted(_patterns().items())))
    pattern = ["--set", f"radar.antenna.pattern={name}"]
    return HardInput(["run", "small.toml", "--no-report", *pattern], {name: draw(changes())(content)})


def _patterns() -> dict[str, bytes]:
    from tempfile import TemporaryDirectory

    found = {}
    with TemporaryDirectory() as folder:
        for name, write in WRITERS.values():
            found[name] = write(make_antenna(20.0, 20.0), Path(folder) / name).read_bytes()
    return found


# Options that would wait for a network, for other processes, or for an hour.
NEVER = ("--mavlink", "--allow-network", "--network", "--scheduler", "--workers", "-o", "--output")
QUICK = ("run", "sweep", "crosscheck", "image", "process", "log", "show", "compare", "merge", "validate", "plan", "fit")
# One shows the city for a minute, and others look at this machine, not at what they are given.
NO_INPUT = ("demo", "doctor", "scenes", "presets", "schema")


def _options() -> dict[str, dict[str, bool]]:
    """Return the options of each command, and whether they take a value."""
    return {
        name: {option: not getattr(given, "is_flag", False) for given in command.params for option in given.opts}
        for name, command in get_command(app).commands.items()
        if name not in NO_INPUT
    }


OPTIONS = {
    name: {option: value for option, value in given.items() if option[0] == "-" and option not in NEVER}
    for name, given in _options().items()
}
# What a command needs to do anything, and values that fit their options.
USUAL = {
    "sweep": ["--vary", "radar.snr_db=10,20"],
    "plan": ["--area", "40x30", "--sampling", "4"],
    "fit": ["--material", "ground"],
    "link": ["--pulses", "200"],
    "crosscheck": ["--pulses", "200"],
    "range-doppler": ["--chirps", "32", "--frames", "1"],
    "budget": ["--repeat", "1"],
    "design": ["--free", "radar.antenna.beamwidth_deg=2:6", "--minimise", "rms_m", "--surveys", "4", "--repeat", "2"],
}
FITTING_WORDS = {
    "--set": ("radar.snr_db=20", "dem.method=smooth", "dem.spacing_m=0.5", "radar.antenna.beamwidth_deg=8", "seed=-1"),
    "--vary": ("radar.antenna.beamwidth_deg=3:6", "seed=1,2", "processing.ranging=peak,centroid", "seed=1:9"),
    "--sample": ("sobol:2", "lhs:3"), "--repeat": ("1", "2"), "--seed": ("0", "7", "18446744073709551615"),
    "--block-size": ("1", "3", "100000"), "--shard": ("1/2", "2/2"), "--runs": ("csv",), "--points": ("csv", "laz"),
    "--record": ("signals", "paths=a.nc", "profiles=b.nc"), "--record-as": ("int16", "float32"),
    "--area": ("200x150", "0x1"), "--sampling": ("0.1", "1e-9"), "--altitude": ("50", "1e9"), "--heading": ("400",),
}  # fmt: skip
ARGUMENTS = (
    "small.toml", "hills", "nowhere.toml", "", "0", "-1", "1e999", "nan", "2/3", "sobol:4", "lhs:2", "sobol:x", "x=1:2",
    "radar.snr_db=10:20", "radar.snr_db=10,20", "radar.snr_db=", "radar.snr_db=nan", "=", "200x150", "small.toml/x",
    "signals=a.nc", "int16", "parquet", "csv", "radar.snr_db=3:6:log", "seed=1:3", "platform=3", "[", "{", "inf",
    "5e-324", "1e300", "9" * 309, "rms_m * " + "9" * 309, "1e-9x1e-9", ".", "..",
)  # fmt: skip


@st.composite
def command_lines(draw: st.DrawFn, commands: Sequence[str] = QUICK) -> HardInput:
    """A command with options of its own, and values that need not fit them."""
    command = draw(st.sampled_from(commands))
    given: list[str] = [command]
    if command != "plan":
        given.append("small.toml" if draw(st.integers(0, 4)) else draw(st.sampled_from(ARGUMENTS)))
    given += USUAL.get(command, []) if draw(st.integers(0, 4)) else []
    words = st.sampled_from(ARGUMENTS) | st.text(st.characters(exclude_characters="/.~\0"), max_size=6)
    for option in draw(st.lists(st.sampled_from(sorted(OPTIONS[command])), max_size=2)):
        given.append(option)
        if OPTIONS[command][option]:
            fits = FITTING_WORDS.get(option)
            given.append(draw(st.sampled_from(fits) if fits and draw(st.booleans()) else words.filter(_encodable)))
    if draw(st.integers(0, 9)) == 0:
        given.append("--no-such-option")
    return HardInput(given)


def _encodable(word: str) -> bool:
    return not any(0xD800 <= ord(letter) < 0xE000 for letter in word)


KINDS = {
    "scenarios": scenarios(),
    "rasters": rasters(),
    "tables": tables(),
    "patterns": patterns(),
    "command lines": command_lines(),
}
