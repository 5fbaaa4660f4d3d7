"""The house: rooms in one order, no circles, and the ray tracer known to few."""

import ast
import contextlib
import importlib
import io
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path

import pytest

import sionna_radar

PACKAGE = Path(sionna_radar.__file__).parent

# Each room may import its own parts and what stands before it. The radar comes after the scene, whose backscatter its
# radar equation integrates; only the accuracy of a map, and what comes after it, knows the truth.
ROOMS = (
    "foundation",
    "execution",
    "raytracer",
    "elevation",
    "weather",
    "scenario",
    "surfaces",
    "flight",
    "scene",
    "radar",
    "tracing",
    "signal",
    "detection",
    "inference",
    "mapping",
    "accuracy",
    "survey",
    "readers",
    "report",
    "cli",
    "studies",
    "notebook",
)
# What the simulator runs without: questions about surveys, foreign formats, pages.
ABOVE_THE_GATE = ("studies", "readers", "report.page", "report.survey.page")
# They take numbers and objects; only the door of each reads tables of a scenario.
PHYSICS = tuple(room for room in ROOMS[ROOMS.index("elevation") : ROOMS.index("survey")] if room != "scenario")
RAY_TRACING = {"sionna", "mitsuba", "drjit"}
KNOW_THE_RAY_TRACER = ("raytracer", "surfaces/sionna_slab.py", "scene", "tracing", "signal/device_beats.py")


def name_of(path: Path) -> str:
    """Return the dotted name of a module within the package; a package's own file has the name of the package."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {name_of(path): path for path in sorted(PACKAGE.rglob("*.py")) if name_of(path)}


@cache
def imports(path: Path) -> set[str]:
    """Return all modules that a file imports, inside functions and by a constant string too, and what it takes."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Call) and getattr(node.func, "id", "") == "import_module":
            found |= {argument.value for argument in node.args if isinstance(argument, ast.Constant)}
    return found


def known(path: Path) -> set[str]:
    """Return the modules of the package that a file imports."""
    ours = {module.removeprefix("sionna_radar.") for module in imports(path) if module.startswith("sionna_radar.")}
    found = {module for module in ours if module in MODULES}
    # Of `from room.part import name` the part counts, not the room that it is in.
    return {module for module in found if not any(other.startswith(f"{module}.") for other in found)}


@cache
def imported() -> dict[str, set[str]]:
    """Return which modules of the package each of them imports; read in the tests, not wherever they are collected."""
    return {name: known(path) - {name} for name, path in MODULES.items()}


def circles(graph: Mapping[str, set[str]]) -> Iterator[str]:
    """Yield a circle of a graph, if there is one."""
    done: set[str] = set()

    def visit(name: str, way: tuple[str, ...]) -> Iterator[str]:
        if name in way:
            yield " -> ".join((*way[way.index(name) :], name))
        elif name not in done:
            for other in graph.get(name, ()):
                yield from visit(other, (*way, name))
            done.add(name)

    for name in graph:
        yield from visit(name, ())


def within(package: str) -> dict[str, set[str]]:
    """Return what the parts of a package, files and packages, import of one another."""
    depth = package.count(".") + 2 if package else 1
    parts: dict[str, set[str]] = {}
    for name, others in imported().items():
        if package and not name.startswith(f"{package}."):
            continue
        own = ".".join(name.split(".")[:depth])
        inside = {".".join(o.split(".")[:depth]) for o in others if not package or o.startswith(f"{package}.")}
        parts.setdefault(own, set()).update(inside - {own})
    return parts


@pytest.mark.parametrize("name", MODULES)
def test_no_module_imports_a_later_room(name):
    room = name.split(".")[0]
    if room == "__main__":
        return
    for other in imported()[name]:
        assert ROOMS.index(other.split(".")[0]) <= ROOMS.index(room), f"{name} imports {other}"


def test_every_module_is_in_a_room():
    assert {name.split(".")[0] for name in MODULES} == {*ROOMS, "__main__"}


def test_no_circle_between_files():
    assert list(circles(imported())) == []


@pytest.mark.parametrize("package", ["", *sorted({name.rpartition(".")[0] for name in MODULES} - {""})])
def test_no_circle_between_the_parts_of_a_package(package):
    assert list(circles(within(package))) == []


def test_a_circle_is_found():
    assert list(circles({"a": {"b"}, "b": {"c"}, "c": {"a"}})) == ["a -> b -> c -> a"]


def test_studies_compute_apart_from_their_documents():
    """Only these files of a study write, draw or print, and no other file of it knows them."""
    for name, path in MODULES.items():
        if name.startswith("studies.") and name.rpartition(".")[2] not in ("document", "figures", "command", "results"):
            tops = {module.split(".")[0] for module in imports(path)}
            assert not tops & {"matplotlib", "rasterio", "laspy", "json", "rich"}, name
            assert not {other for other in imported()[name] if other.startswith(("report", "cli"))}, name


def test_nothing_outside_a_study_names_it():
    """But the studies that declare their need of it, and the public names of the package."""
    for name, others in imported().items():
        own = name.split(".")[1] if name.startswith("studies.") else None
        for other in {other.split(".")[1] for other in others if other.startswith("studies.")} - {own}:
            assert own is not None, f"{name} imports the study {other}"
            assert other in getattr(importlib.import_module(f"sionna_radar.studies.{own}"), "NEEDS", ()), name


def test_the_line_does_not_import_what_is_above_the_gate():
    below = ROOMS[: ROOMS.index("readers")]
    for name, others in imported().items():
        if name.split(".")[0] in below:
            assert not [other for other in others if other.startswith((*ABOVE_THE_GATE, "report", "cli"))], name


FLY = """
import hashlib
from sionna_radar import load_scenario, run
for name, length in (("hills", 4.0), ("buildings", 4.0), ("rain", 3.0)):
    survey = run(load_scenario(name, {"platform.length_m": length}))
    arrays = survey.points.position_m, survey.points.range_sigma_m, survey.dem.height_m, survey.error.height_m
    print(name, len(survey.points), hashlib.sha256(b"".join(map(bytes, arrays))).hexdigest())
"""


def without(folder: Path, *removed: str) -> Path:
    """Return a folder with a copy of the package and its scenes, but for some modules and packages."""
    shutil.copytree(PACKAGE, folder / PACKAGE.name)
    shutil.copytree(PACKAGE.parent / "scenes", folder / "scenes")
    for name in removed:
        place = (folder / PACKAGE.name).joinpath(*name.split("."))
        shutil.rmtree(place) if place.is_dir() else place.with_suffix(".py").unlink()
    return folder


def test_the_core_flies_alone(tmp_path):
    """With all above the gate removed, surveys have the same bits."""
    # Flown here first: the copy takes the compiled loops along.
    own = io.StringIO()
    with contextlib.redirect_stdout(own):
        exec(FLY, {})
    alone = run(FLY, without(tmp_path, "studies", "readers", "report", "cli", "notebook"))
    assert alone.count("\n") == 3
    assert alone == own.getvalue()


# Takes some studies at a time out of the package, and imports all above the gate anew: nothing below knows of studies;
# prints the commands that are left.
EACH_AWAY = """
import gc, importlib, pathlib, sys
import sionna_radar
gc.disable()
studies = pathlib.Path(sionna_radar.__file__).parent / "studies"
for taken in {rounds}:
    lost = tuple(f"sionna_radar.studies.{{study}}." for study in taken)
    away = [(studies / study).rename(studies.parent.parent / study) for study in taken]
    for name in [name for name in sys.modules if name.startswith({above})]:
        del sys.modules[name]
    importlib.invalidate_caches()
    for name in {names}:
        if not (name + ".").startswith(lost):
            importlib.import_module(name)
    print(*(c.name for c in sys.modules["sionna_radar.cli.app"].LISTED))
    for place in away:
        place.rename(studies / place.name)
"""


def rounds_of(lost: Mapping[str, set[str]]) -> list[list[str]]:
    """Return sets of studies so that each is once away where any other is there that does not need it.

    lost: of each study, itself and those that need it.
    """
    apart = {(there, away) for away in lost for there in lost if there not in lost[away]}

    def told(taken: set[str]) -> set[tuple[str, str]]:
        return {(there, away) for there, away in apart if away in taken and there not in taken}

    rounds = []
    while apart:
        taken: set[str] = set()
        for study in lost:
            taken = max(taken, taken | lost[study], key=lambda some: len(told(some)))
        rounds.append(sorted(taken))
        apart -= told(taken)
    return rounds


def test_all_the_rest_is_imported_without_a_study(tmp_path):
    """But the studies that declare their need of it; and the command line has the commands of all others."""
    from sionna_radar.cli.app import LISTED

    studies = sorted({name.split(".")[1] for name in MODULES if name.startswith("studies.")})
    needs = {study: getattr(importlib.import_module(f"sionna_radar.studies.{study}"), "NEEDS", ()) for study in studies}
    rounds = rounds_of({study: {one for one in studies if study in (one, *needs[one])} for study in studies})
    above = tuple(f"sionna_radar.{room}" for room in ("studies", "readers", "report", "cli", "notebook"))
    names = [f"sionna_radar.{name}" for name in MODULES if f"sionna_radar.{name}".startswith(above)]
    code = EACH_AWAY.format(names=names, rounds=rounds, above=above)
    listed = [line.split() for line in run(code, without(tmp_path)).splitlines()]
    inside = [tuple(f"sionna_radar.studies.{study}." for study in taken) for taken in rounds]
    assert listed == [[c.name for c in LISTED if not c.call.__module__.startswith(lost)] for lost in inside]
    assert set().union(*rounds) == set(studies)
    assert len(studies) == 20


def test_no_map_knows_the_truth():
    """Neither detection nor mapping reads the true pose, or traces."""
    for name, path in MODULES.items():
        if name.split(".")[0] in ("detection", "mapping"):
            assert not any(other.startswith("tracing.") for other in imported()[name]), name
            assert ".true." not in path.read_text(encoding="utf-8"), name


def test_physics_reads_tables_of_a_scenario_at_its_doors_alone():
    """Each room has one `build.py`, terrains and thin obstacles another; all other files take numbers.

    Tables of parameters that parts declare in a room stand in its `options.py`.
    """
    readers = {
        name
        for name in MODULES
        if name.split(".")[0] in PHYSICS and any(other.split(".")[0] == "scenario" for other in imported()[name])
    }
    assert {name for name in readers if name.rpartition(".")[2] not in ("build", "options")} == set()
    assert len(readers) <= 14


def knows_the_ray_tracer(path: Path) -> bool:
    return any(module.split(".")[0] in RAY_TRACING for module in imports(path))


def test_few_know_the_ray_tracer():
    for path in MODULES.values():
        if not str(path.relative_to(PACKAGE).as_posix()).startswith(KNOW_THE_RAY_TRACER):
            assert not knows_the_ray_tracer(path), path.relative_to(PACKAGE)


def run(code: str, folder: Path | None = None, **environment: str) -> str:
    """Return what a program prints; the package of a folder goes before the installed one."""
    settings = {key: value for key, value in os.environ.items() if key != "DRJIT_LIBLLVM_PATH"} | environment
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=settings, check=False, cwd=folder
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_what_does_not_trace_loads_no_ray_tracer():
    """Nor do the engines' names; importing the package loads nothing but itself, and validating a scenario no part."""
    trace = ("tracing.engines", "tracing.sionna", "signal.device_beats")
    modules = [f"sionna_radar.{name}" for name in MODULES if not name.startswith(trace) and name != "__main__"]
    code = f"""
import importlib, sys
import sionna_radar
print(*sys.modules)
from sionna_radar.scenario import load_scenario
load_scenario("buildings")
print(*sys.modules)
for module in {modules}:
    importlib.import_module(module)
    for name in {sorted(RAY_TRACING)}:
        if name in sys.modules:
            sys.exit(module + " loads " + name)
"""
    at_first, validating = (line.split() for line in run(code).splitlines())
    assert not {name.split(".")[0] for name in at_first} & (RAY_TRACING | {"numpy", "scipy", "pydantic"})
    assert [name for name in at_first if name.startswith("sionna_radar")] == ["sionna_radar"]
    loaded = {name.removeprefix("sionna_radar.") for name in validating if name.startswith("sionna_radar.")}
    physics = {name for name in loaded if name.split(".")[0] in PHYSICS and name in MODULES}
    declared = {name for name in physics if name.endswith(".options") or MODULES[name].name == "__init__.py"}
    # The weather's limits of frequency are checked.
    assert {name.split(".")[0] for name in physics - declared} == {"weather"}, physics


# Stops at the first import of the ray tracer, and reports whether the library was chosen by then.
CHOSEN_BEFORE = """
import importlib, os, sys

class Stop:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {tracers}:
            print(module, "DRJIT_LIBLLVM_PATH" in os.environ)
            raise ImportError("stopped")

sys.meta_path.insert(0, Stop())
for module in {modules}:
    os.environ.pop("DRJIT_LIBLLVM_PATH", None)
    for name in [name for name in sys.modules if name.startswith("sionna_radar")]:
        del sys.modules[name]
    try:
        importlib.import_module(module)
    except ImportError as error:
        assert str(error) == "stopped", error
"""


def test_every_tracing_module_chooses_the_libllvm_before_the_ray_tracer_loads():
    """Dr.Jit reads DRJIT_LIBLLVM_PATH when it is imported; an old library ends the process."""
    modules = [
        f"sionna_radar.{name}"
        for name, path in MODULES.items()
        if name.startswith("tracing.") and knows_the_ray_tracer(path)
    ]
    assert len(modules) >= 5
    reported = run(CHOSEN_BEFORE.format(tracers=sorted(RAY_TRACING), modules=modules)).splitlines()
    assert reported == [f"{module} True" for module in modules]


def test_a_first_survey_waits_for_no_library_that_it_does_not_use():
    """Each of these takes a tenth of a second or more to import; and the ray tracer works with the chosen libLLVM."""
    modules = ", ".join(
        f"sionna_radar.{name}"
        for name in ("survey.chain", "tracing.engines.persistent.persistent", "report.survey.summary")
    )
    code = f"import sys, {modules}; print(*sys.modules); import mitsuba as mi; print(mi.Float([1, 2]) + 1)"
    loaded, total = run(code, SIONNA_RADAR_BACKEND="llvm").splitlines()
    assert not set(loaded.split()) & {"scipy.signal", "scipy.stats", "trimesh", "laspy"}
    assert "sionna_radar.report.survey.figures" not in loaded.split()
    assert total == "[2, 3]"
