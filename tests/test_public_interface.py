"""What a script may rely on: the public names, what they say of themselves, and that the examples need no others."""

import ast
import doctest
import importlib
import inspect
import re
from importlib.metadata import requires, version
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import sionna_radar
from sionna_radar.studies.design import search, statement
from sionna_radar.studies.gradients import study as gradients_study
from sionna_radar.studies.link import study as link_study

ROOT = Path(__file__).resolve().parents[1]
SCRIPTS = [*sorted((ROOT / "examples").rglob("*.py"))]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "examples").glob("*.md"))]
# Their docstrings state no shapes or units: they have no arguments that have any.
CLASSES = [name for name in sionna_radar.__all__ if inspect.isclass(getattr(sionna_radar, name))]
FUNCTIONS = [name for name in sionna_radar.__all__ if name not in CLASSES]


def packages() -> list[str]:
    """Return the packages whose public names a script may import."""
    top = Path(sionna_radar.__file__).parent
    return [".".join(stub.parent.relative_to(top.parent).parts) for stub in sorted(top.rglob("__init__.pyi"))]


def public_imports(code: str) -> list[tuple[str, str]]:
    """Return what some code imports of the package: the module, and the name or ''."""
    found = []
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "sionna_radar":
            found += [(node.module, alias.name) for alias in node.names]
        elif isinstance(node, ast.Import):
            found += [(alias.name, "") for alias in node.names if alias.name.split(".")[0] == "sionna_radar"]
    return found


def assert_public(code: str, where: object) -> None:
    for module, name in public_imports(code):
        assert module in packages(), f"{where} imports {module}, which is not public"
        assert not name or name in importlib.import_module(module).__all__, f"{where}: {module}.{name} is not public"


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.name)
def test_examples_import_public_names_only(path):
    assert_public(path.read_text(encoding="utf-8"), path.name)


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_pages_import_public_names_only(path):
    for block in re.findall(r"```python\n(.*?)```", path.read_text(encoding="utf-8"), re.DOTALL):
        assert_public(block, path.name)


def test_an_inner_name_is_noticed():
    with pytest.raises(AssertionError, match="not public"):
        assert_public("from sionna_radar.survey.chain import run", "a script")
    with pytest.raises(AssertionError, match="not public"):
        assert_public("from sionna_radar.survey import _run", "a script")


def test_there_are_about_thirty_names_and_one_of_each_study_and_dir_lists_them():
    stub = (Path(sionna_radar.__file__).with_suffix(".pyi")).read_text(encoding="utf-8")
    studies = re.findall(r"from \.studies\.(\w+)\.\w+ import", stub)
    folders = sorted(path.parent.name for path in Path(sionna_radar.__file__).parent.glob("studies/*/__init__.py"))
    # A radar that is stepped is two things: it, and the map of what it hears.
    assert sorted(studies) == sorted([*folders, "live"])
    assert 25 <= len(sionna_radar.__all__) - len(studies) <= 32
    assert {*sionna_radar.__all__, "__version__"} <= set(dir(sionna_radar))
    assert sionna_radar.__version__ == version("sionna-radar")


@pytest.mark.parametrize("package", packages())
def test_the_names_of_a_package_are_found(package):
    module = importlib.import_module(package)
    assert module.__all__ == sorted(module.__all__)
    for name in module.__all__:
        thing = getattr(module, name)
        if inspect.isclass(thing) or inspect.isfunction(thing):  # constants and aliases have no name of their own
            assert thing.__name__ == name
    with pytest.raises(AttributeError, match="nothing_here"):
        module.nothing_here  # noqa: B018


@pytest.mark.parametrize("name", sionna_radar.__all__)
def test_a_public_name_says_what_it_is_with_an_example(name):
    text = inspect.getdoc(getattr(sionna_radar, name))
    assert text
    assert ">>>" in text, "no example"
    if name in FUNCTIONS and inspect.signature(getattr(sionna_radar, name)).parameters:
        assert "Parameters\n----------" in text
        assert "Raises\n------" in text


# Rooms of the core, whose functions take and return numbers with units and shapes.
CORE = (
    *("foundation", "weather", "scenario", "surfaces", "flight", "scene"),
    *("radar", "tracing", "signal", "detection", "mapping", "accuracy", "survey"),
)


def public_functions():
    """Return the public functions of the package itself and of the core by their full names."""
    rooms = [sionna_radar, *(importlib.import_module(f"sionna_radar.{room}") for room in CORE)]
    named = {f"{room.__name__}.{name}": getattr(room, name) for room in rooms for name in room.__all__}
    return {name: function for name, function in named.items() if inspect.isfunction(function)}


@pytest.mark.parametrize("name", sorted(public_functions()))
def test_a_public_function_states_its_parameters_and_what_it_returns(name):
    function = public_functions()[name]
    text, signature = inspect.getdoc(function), inspect.signature(function)
    assert "Returns\n-------\n" in text
    if signature.parameters:
        section = text.partition("Parameters\n----------\n")[2]
        stated = {word for line in re.findall(r"^(\w.*):$", section, re.MULTILINE) for word in line.split(", ")}
        assert set(signature.parameters) <= stated


# Keys with which the flights and drives of the examples are quick.
QUICK = {
    "hills": {"terrain.spacing_m": 2.0, "tracing.paths_per_pulse": 64},
    "stadium": {"tracing.paths_per_pulse": 256},
}


def load_coarse(name, overrides=None):
    """Load a scenario; the hills of the examples on a coarser mesh."""
    overrides = overrides or {}
    quick = {} if "terrain" in overrides else QUICK.get(name, {})
    return sionna_radar.load_scenario(name, quick | overrides)


# One parameter needs no more candidates for the next setting; of a detector and of standard errors nothing is shown.
FEW = {
    search: {"POOL": 64, "NEAR": 8},
    statement: {"SOBOL_SAMPLES": 64},
    gradients_study: {"DRAWS": 2},
    link_study: {"SURVEY_PULSES": 30},
}


@pytest.mark.usefixtures("forgotten", "rough_errors")
@pytest.mark.parametrize("name", sionna_radar.__all__)
def test_the_example_of_a_public_name_does_what_it_says(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for module, sizes in FEW.items():
        for size, number in sizes.items():
            monkeypatch.setattr(module, size, number)
    thing = getattr(sionna_radar, name)
    everything = {public: getattr(sionna_radar, public) for public in sionna_radar.__all__}
    everything["load_scenario"] = load_coarse
    found = doctest.DocTestFinder(recurse=False).find(thing, name, globs=everything)
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    assert found
    assert found[0].examples
    for case in found:
        runner.run(case)
    assert runner.failures == 0


def test_the_lock_has_what_the_package_needs_and_names_no_host():
    lock = (ROOT / ".ci" / "requirements.txt").read_text(encoding="utf-8")
    locked = {line.split("==")[0]: line.split("==")[1].split()[0] for line in lock.splitlines() if "==" in line}
    assert "://" not in lock
    assert "--index-url" not in lock
    assert lock.count("--hash=sha256:") >= len(locked)
    for needed in map(Requirement, requires("sionna-radar")):
        if needed.marker is None or needed.marker.evaluate({"extra": "cluster"}):
            assert needed.specifier.contains(locked[canonicalize_name(needed.name)]), needed
