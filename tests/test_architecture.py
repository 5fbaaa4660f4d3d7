"""The data flow one way: no stage knows a later one, and only two of them know Sionna."""

import ast
import os
import pydoc
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

import sionna_radar

PACKAGE = Path(sionna_radar.__file__).parent

# Each may import itself and what stands before it. The radar comes after the scene, whose backscatter its radar
# equation integrates.
ORDER = (
    ("errors", "decibel", "input_file", "interrupts", "linear_algebra"),
    ("georeference", "progress", "randomness", "raster", "stopwatch"),
    ("weather",),
    ("scenario",),
    ("flight",),
    ("scene",),
    ("radar",),
    ("tracing",),
    ("signal",),
    ("detection",),
    ("imaging",),
    ("mapping", "speckle_test"),
    ("limits", "expected_ground"),
    ("preparation",),
    ("sensors",),
    ("notes",),
    ("survey",),
    ("remapping",),
    ("planning",),
    ("plan_check",),
    ("report", "crosscheck", "sweep", "budget", "image"),
)
RANK = {name: rank for rank, names in enumerate(ORDER) for name in names}
RAY_TRACING = {"sionna", "mitsuba", "drjit"}


def stage(module: str) -> str:
    """Return the part of the package that a dotted module belongs to."""
    return module.split(".")[1] if "." in module else ""


def sources(*folders: str) -> list[Path]:
    return sorted(
        path for path in PACKAGE.rglob("*.py") if path.relative_to(PACKAGE).parts[0].removesuffix(".py") in folders
    )


def imports(path: Path) -> set[str]:
    """Return all modules that a file imports, those inside functions too."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def knows_the_ray_tracer(path: Path) -> bool:
    return any(module.split(".")[0] in RAY_TRACING for module in imports(path))


@pytest.mark.parametrize("name", RANK)
def test_no_stage_imports_a_later_one(name):
    for path in sources(name):
        for module in imports(path):
            if module.startswith("sionna_radar."):
                # What has no place in ORDER (the command line, benches) stands above all stages.
                rank = RANK.get(stage(module), len(ORDER))
                assert rank <= RANK[name], f"{path.relative_to(PACKAGE)} imports {module}"


def test_stages_of_equal_rank_are_one_stage():
    """Foundations know nothing of each other but errors."""
    for name in ORDER[0]:
        for path in sources(name):
            known = {stage(m) for m in imports(path) if m.startswith("sionna_radar.")}
            assert known <= {name, "errors"}, path


def test_only_scene_and_tracing_know_the_ray_tracer():
    for path in sorted(PACKAGE.rglob("*.py")):
        if path.relative_to(PACKAGE).parts[0] in ("scene", "tracing"):
            continue
        assert not knows_the_ray_tracer(path), path.relative_to(PACKAGE)


def run(code: str, **environment: str) -> str:
    settings = {key: value for key, value in os.environ.items() if key != "DRJIT_LIBLLVM_PATH"} | environment
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=settings, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def loaded_by(statement: str) -> set[str]:
    return {module.split(".")[0] for module in run(f"import sys; {statement}; print(' '.join(sys.modules))").split()}


# Stops at the first import of the ray tracer, and tells whether the library was chosen by then.
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
    modules = [f"sionna_radar.tracing.{path.stem}" for path in filter(knows_the_ray_tracer, sources("tracing"))]
    assert len(modules) >= 5
    told = run(CHOSEN_BEFORE.format(tracers=sorted(RAY_TRACING), modules=modules)).splitlines()
    assert told == [f"{module} True" for module in modules]


def test_the_ray_tracer_works_with_the_libllvm_that_was_chosen():
    code = "import sionna_radar.tracing.engines.beam, mitsuba as mi; print(mi.Float([1, 2]) + 1)"
    assert run(code, SIONNA_RADAR_VARIANT="llvm_ad_mono_polarized").strip() == "[2, 3]"


def test_importing_the_package_loads_neither_numpy_nor_the_ray_tracer():
    assert not loaded_by("import sionna_radar") & (RAY_TRACING | {"numpy", "scipy", "pydantic"})


def test_what_does_not_trace_loads_no_ray_tracer():
    paths = [p.relative_to(PACKAGE).with_suffix("") for p in sorted(PACKAGE.rglob("*.py"))]
    modules = [".".join(("sionna_radar", *p.parts)) for p in paths if p.parts[0] != "tracing" and p.stem[0] != "_"]
    code = f"""
import importlib, sys
for module in {modules}:
    importlib.import_module(module)
    for name in {sorted(RAY_TRACING)}:
        if name in sys.modules:
            sys.exit(module + " loads " + name)
"""
    assert run(code) == ""


def test_the_packages_names_are_found():
    for name in sionna_radar.__all__:
        assert getattr(sionna_radar, name).__name__ == name
    with pytest.raises(AttributeError, match="nothing_here"):
        sionna_radar.nothing_here  # noqa: B018


def test_the_package_tells_of_itself():
    assert sionna_radar.__version__ == version("sionna-radar")
    assert {*sionna_radar.__all__, "__version__"} <= set(dir(sionna_radar))
    assert "load_scenario" in pydoc.render_doc(sionna_radar, renderer=pydoc.plaintext)
