"""The numbers that decide in mapping and detection, found by the program, and what halving and doubling each changes.

A variation runs in a process of its own, into which the package is imported with one assignment changed: so the change
reaches default arguments, numbers derived from it and modules that import it. Machine code on disk holds the numbers it
was compiled with, and is used only for functions that see the same ones.
"""

import ast
import importlib
import json
import math
import pkgutil
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from importlib.abc import MetaPathFinder
from importlib.machinery import PathFinder, SourceFileLoader
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parent.parent / "sionna_radar"
ROOMS = ("mapping", "inference", "detection")
# Third-party modules that a server of processes loads once.
PRELOADED = ["numba", "scipy.optimize", "scipy.spatial", "scipy.ndimage", "scipy.interpolate", "scipy.integrate",
             "scipy.signal", "pydantic", "jaxtyping", "rasterio", "h5netcdf", "matplotlib.path", "pyproj"]  # fmt: skip
# Shares near one: the rest to one is halved and doubled.
SHARES = {"MIN_PROBABILITY", "MIN_FILL_FACTOR", "MIN_RAISED_FRACTION", "EDGE_LEVEL"}
HALF, DOUBLE = 0.5, 2.0
# Names of what is no quantity, or bounds memory alone, by the reason.
NOT_VARIED = {
    "a code or a list of neighbours": {
        *(
            "CELL_AVERAGING",
            "GREATEST_OF",
            "SMALLEST_OF",
            "NOTHING",
            "coarse_map.DIRECTIONS",
            "segments.AROUND",
            "EVERYWHERE",
            "SEED",
        ),
        *("LONG", "KEY", "COARSER", "GROUND_ALONE", "PLANTS_ALONE", "BOTH"),
    },
    "how many are worked on at once, or may be": {
        *("SQUARE", "MAX_CELLS_READ", "MAX_DEM_CELLS", "MAX_CLOSED_CELLS"),
    },
}


@dataclass(frozen=True, order=True)
class Constant:
    """A numeric module-level constant. text: its value in the source; comment: the lines above it."""

    module: str
    name: str
    text: str
    comment: str = ""

    @property
    def room(self) -> str:
        """Its package within the room: `mapping.stepped`, `detection.volume`, ..."""
        return self.module.rpartition(".")[0] or self.module

    def __str__(self) -> str:
        return f"{self.module}.{self.name}"


def constants(rooms: tuple[str, ...] = ROOMS) -> list[Constant]:
    """All upper-case names assigned at the top of the modules of some rooms whose values hold numbers."""
    found = []
    for path in sorted(path for room in rooms for path in (ROOT / room).rglob("*.py")):
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        source = path.read_text(encoding="utf-8")
        values = vars(importlib.import_module(f"sionna_radar.{module}"))
        for statement in ast.parse(source).body:
            for target, value in _assigned(statement):
                if target.isupper() and _numeric(values[target]):
                    text = ast.get_source_segment(source, value) or ""
                    found.append(Constant(module, target, text, _comment(source, statement.lineno)))
    return found


def _assigned(statement: ast.stmt) -> Iterator[tuple[str, ast.expr]]:
    """Names and values of an assignment; those of a tuple one by one."""
    if isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name) and statement.value:
        yield statement.target.id, statement.value
    if isinstance(statement, ast.Assign):
        for target in statement.targets:
            if isinstance(target, ast.Name):
                yield target.id, statement.value
            elif isinstance(target, ast.Tuple) and isinstance(statement.value, ast.Tuple):
                for name, value in zip(target.elts, statement.value.elts, strict=True):
                    yield name.id, value


def _numeric(value: Any) -> bool:
    if isinstance(value, tuple):
        return len(value) > 0 and all(_numeric(part) for part in value)
    if isinstance(value, np.ndarray):
        return value.size > 0 and value.dtype.kind in "if"
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _comment(source: str, line: int) -> str:
    lines, above = source.splitlines(), []
    for number in range(line - 2, -1, -1):
        if not lines[number].startswith("#"):
            break
        above.insert(0, lines[number].lstrip("# "))
    return " ".join(above)


def scaled(value: Any, factor: float, share: bool = False) -> Any:
    """A number, or all of a tuple or array, times a factor; whole numbers stay whole and at least one."""
    if isinstance(value, tuple):
        return tuple(scaled(part, factor, share) for part in value)
    if isinstance(value, int):
        return int(math.copysign(max(1, round(abs(value) * factor)), value)) if value else value
    return 1 - (1 - value) / factor if share else value * factor


class _Loader(SourceFileLoader):
    """Imports a module with one of its constants scaled."""

    constant: str
    factor: float

    def get_code(self, fullname: str) -> Any:
        path = self.get_filename(fullname)
        tree = ast.parse(self.get_data(path))
        for statement in tree.body:
            for name, value in _assigned(statement):
                if name == self.constant:
                    share = ast.Constant(name in SHARES)
                    call = ast.Call(ast.Name("__scaled__", ast.Load()), [value, ast.Constant(self.factor), share], [])
                    _put(statement, name, call)
        return compile(ast.fix_missing_locations(tree), path, "exec")

    def exec_module(self, module: Any) -> None:
        vars(module)["__scaled__"] = scaled
        super().exec_module(module)


def _put(statement: Any, name: str, call: ast.Call) -> None:
    target = statement.target if isinstance(statement, ast.AnnAssign) else statement.targets[0]
    if isinstance(target, ast.Tuple):
        statement.value.elts[[each.id for each in target.elts].index(name)] = call
    else:
        statement.value = call


class _Finder(MetaPathFinder):
    def __init__(self, constant: Constant, factor: float) -> None:
        self._constant, self._factor = constant, factor

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> Any:
        if fullname != f"sionna_radar.{self._constant.module}":
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        assert spec is not None
        assert spec.origin is not None
        loader = _Loader(fullname, spec.origin)
        loader.constant, loader.factor = self._constant.name, self._factor
        spec.loader = loader
        return spec


def machine_code() -> dict[str, Any]:
    """All compiled functions of the package, by module and name."""
    import sionna_radar
    from sionna_radar.foundation.compiled import CompiledFunction

    for room in (*ROOMS, "elevation"):
        package = importlib.import_module(f"sionna_radar.{room}")
        for info in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            importlib.import_module(info.name)
    assert sionna_radar
    modules = [module for name, module in sys.modules.items() if name.startswith("sionna_radar.")]
    every = [value for module in modules for value in vars(module).values() if isinstance(value, CompiledFunction)]
    return {f"{each.py_func.__module__}.{each.py_func.__name__}": each for each in every}


def fingerprints() -> dict[str, str]:
    """The numbers that each compiled function sees, its own and those of functions that it calls."""
    every, found = machine_code(), {}

    def of(key: str) -> str:
        if key not in found:
            found[key] = ""
            function = every[key].py_func
            parts = []
            for name in function.__code__.co_names:
                value = function.__globals__.get(name)
                if hasattr(value, "py_func"):
                    parts.append(of(f"{value.py_func.__module__}.{value.py_func.__name__}"))
                elif _numeric(value):
                    parts.append(f"{name}={value!r}")
            found[key] = ";".join(parts)
        return found[key]

    return {key: of(key) for key in every}


@dataclass(frozen=True)
class Survey:
    """A recorded flight: its file, and the methods by which it is mapped, by processing settings."""

    name: str
    recording: Path
    methods: tuple[str, ...]
    settings: tuple[tuple[str, Any], ...] = ()


Maps = dict[str, np.ndarray]


def maps_of(surveys: tuple[Survey, ...], options: Mapping[str, Any] | None = None) -> dict[str, Maps]:
    """The error, the stated standard deviation and the lit cells of each map, by survey and method."""
    from sionna_radar.execution.execution import Execution
    from sionna_radar.mapping.build import build_dem_method
    from sionna_radar.survey.observation import observe
    from sionna_radar.survey.placement import place
    from sionna_radar.survey.recording_source import open_recording
    from sionna_radar.survey.recordings import netcdf

    netcdf._probe = lambda *_: None  # the files are our own: no other process need look at them first

    found: dict[str, Maps] = {}
    for survey in surveys:
        for echoes in dict.fromkeys("all" if name == "stepped" else "strongest" for name in survey.methods):
            names = [name for name in survey.methods if (name == "stepped") == (echoes == "all")]
            keeps = "linear" if names == ["linear"] else "refined"
            changes = dict(survey.settings) | {"processing.echoes": echoes}
            own = {key: value for key, value in (options or {}).items() if key.startswith("processing")}
            with open_recording(survey.recording, changes | own | {"dem.method": keeps}) as source:
                sensor, observed = observe(source, Execution())
                points = place(observed.echoes, sensor, source.flight)
                truth = source.file.truth
                for name in names:
                    of_method = {
                        key.rpartition(".")[2]: value
                        for key, value in (options or {}).items()
                        if key.startswith(f"dem.{name}.")
                    }
                    given = {"method": name} | ({"method_parameters": of_method} if of_method else {})
                    table = type(source.settings.dem).model_validate(
                        source.settings.dem.model_dump(exclude={"method_parameters"}) | given
                    )
                    mapper = replace(source.mapper_of(points), method=build_dem_method(table), name=name)
                    made = mapper.map(points, observed.profiles, source.file.pose)
                    sigma = made.sigma.height_m if made.sigma else np.full(made.dem.grid.shape, np.nan)
                    found["|".join([survey.name, name, *(str(value) for _, value in survey.settings)])] = {
                        "height": made.dem.height_m,
                        "sigma": sigma,
                        "truth": np.where(truth.lit, truth.surface.height_m, np.nan),
                    }
    return found


def compared(before: Maps, after: Maps) -> dict[str, float]:
    """What a variation changes: of the DEM over its error, of that error, of cells filled, and inside 95 %.

    moved: RMS change of the DEM over its RMS error, in cells that both fill; error: relative change of the RMS error;
    filled: share of the lit cells that one of them fills; inside: change of the share inside the 95 % interval.
    """
    lit = np.isfinite(before["truth"])
    both = lit & np.isfinite(before["height"]) & np.isfinite(after["height"])
    apart = (np.isfinite(before["height"]) != np.isfinite(after["height"])) & lit
    error, inside = [], []
    for one in (before, after):
        off = one["height"] - one["truth"]
        held = np.abs(off) <= 1.96 * one["sigma"]
        known = lit & np.isfinite(off)
        error.append(float(np.sqrt(np.mean(off[known] ** 2))) if known.any() else np.nan)
        inside.append(float(held[known & np.isfinite(one["sigma"])].mean()) if known.any() else np.nan)
    moved = float(np.sqrt(np.mean((after["height"] - before["height"])[both] ** 2))) if both.any() else np.nan
    return {
        "moved": moved / error[0],
        "error": error[1] / error[0] - 1,
        "filled": float(apart.sum() / lit.sum()),
        "inside": inside[1] - inside[0],
    }


@dataclass(frozen=True)
class Variation:
    """A constant times a factor, or options in place of their defaults; neither for the maps as they are."""

    key: str
    constant: Constant | None = None
    factor: float = 1.0
    options: tuple[tuple[str, Any], ...] = ()


def vary(folder: Path, variation: Variation, surveys: tuple[Survey, ...]) -> None:
    """Map with one variation, and keep what it changes in a file; in a process of its own."""
    if variation.constant is not None:
        sys.meta_path.insert(0, _Finder(variation.constant, variation.factor))
    seen = fingerprints()
    if variation.key == "base":
        (folder / "fingerprints.json").write_text(json.dumps(seen))
    else:
        from numba.core.caching import NullCache

        kept, every = json.loads((folder / "fingerprints.json").read_text()), machine_code()
        for name, numbers in seen.items():
            if kept[name] != numbers:
                every[name].machine_code._cache = NullCache()
    try:
        result: dict[str, Any] = {}
        for name, made in maps_of(surveys, dict(variation.options)).items():
            file = folder / f"{name.replace('|', '-').replace(' ', '_')}.npz"
            if variation.key == "base":
                np.savez(file, **made)
            else:
                with np.load(file) as before:
                    result[name] = compared(dict(before), made)
    except Exception as error:  # a value that the program refuses decides, too
        result = {"failed": f"{type(error).__name__}: {error}"}
    (folder / f"{variation.key}.json").write_text(json.dumps(result))


def run_variations(folder: Path, wanted: list[tuple[Variation, tuple[Survey, ...]]], workers: int = 1) -> None:
    """Map with each variation whose file is not there yet."""
    context = get_context("forkserver")
    context.set_forkserver_preload(PRELOADED)
    waiting = [each for each in wanted if not (folder / f"{each[0].key}.json").exists()]
    running: list[Any] = []
    for variation, surveys in waiting:
        while len(running) >= workers:
            running[0].join()
            running = [process for process in running if process.is_alive()]
        process = context.Process(target=vary, args=(folder, variation, surveys))
        process.start()
        running.append(process)
    for process in running:
        process.join()


def kept(folder: Path, key: str) -> dict[str, Any]:
    """What a variation changed, by survey and method; empty for one that was not flown."""
    path = folder / f"{key}.json"
    return json.loads(path.read_text()) if path.exists() else {}


def tolerances(folder: Path, every: list[Constant]) -> str:
    """A table of constants by module: each with the largest change of a map, over its RMS error, halved or doubled.

    One that was flown in one of the two ways alone says in which; one that was in none, that it was not.
    """
    lines = ["| module | constants, with the largest change of a map over its error |", "|---|---|"]
    for module in dict.fromkeys(each.module for each in every):
        cells = []
        for constant in (each for each in every if each.module == module):
            flown = {which: kept(folder, f"{constant}-{which}") for which in ("half", "double")}
            flown = {which: result for which, result in flown.items() if result}
            moved = [c["moved"] for result in flown.values() for c in result.values() if isinstance(c, dict)]
            way = {0: "not varied yet", 1: f"{max(moved, default=math.nan):.2f} ({''.join(flown)})"}
            cells.append(f"`{constant.name}` {way.get(len(flown), f'{max(moved, default=math.nan):.2f}')}")
        lines.append(f"| `{module}` | {', '.join(cells)} |")
    return "\n".join(lines)


def sensitivities(folder: Path, keys: list[tuple[str, str, str]], flights: tuple[str, ...]) -> str:
    """A table of options, with unit and default: the change of the RMS error over each ground, halved and doubled."""
    lines = [
        "| option | unit | default | halved: " + ", ".join(flights) + " | doubled | largest change of a map |",
        "|---|---|---|---|---|---|",
    ]
    for key, unit, default in keys:
        halved, doubled = (kept(folder, f"{key}-{which}") for which in ("half", "double"))
        moved = [c["moved"] for result in (halved, doubled) for c in result.values() if isinstance(c, dict)]
        changes = [", ".join(_percent(each, flight) for flight in flights) for each in (halved, doubled)]
        lines.append(
            f"| `{key}` | {unit or '-'} | {default} | {changes[0]} | {changes[1]} | {max(moved, default=0):.2f} |"
        )
    return "\n".join(lines)


def _percent(result: dict[str, Any], flight: str) -> str:
    own = [change["error"] for name, change in result.items() if name.split("|")[0] == flight]
    return f"{100 * own[0]:+.0f} %" if own else "refused" if "failed" in result else "-"
