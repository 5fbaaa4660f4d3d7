"""The command line, and the scenes and antennas that the tests of several stages share."""

import contextlib
import gc
import logging
import os
import sys

# The workers share the cores: they, and the programs that they start, take this over; NumPy reads it when it loads.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Threads of several workers on one core wait for each other: an eighth of the processor time. What threads change, or
# must not, is tested by those that set their number, and by all with `-n 0` or the variable set, as `.ci/run` does.
if workers := int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "0")):
    os.environ.setdefault("SIONNA_RADAR_THREADS", str(max((os.cpu_count() or 1) // workers, 1)))

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import jaxtyping
import pytest
from hypothesis import settings

import typechecks

# The process that hands the tests to workers, which start after it has read this file, needs none of the package.
if TYPE_CHECKING:
    from sionna_radar.radar.antenna import Antenna
    from sionna_radar.scene.model import Scene

# How long an example takes says more of the machine than of the code. The same examples in each run, so that a failure
# is of the change; `pytest -m hypothesis --hypothesis-profile search` looks for new ones.
settings.register_profile("any machine", deadline=None, derandomize=True)
settings.register_profile("search", deadline=None)
settings.load_profile("any machine")


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("hostile")
    group.addoption("--hostile-inputs", type=int, default=10_000, help="Inputs of `-m hostile`, of all kinds together.")
    group.addoption("--hostile-seed", type=int, default=0, help="Seed of the inputs of `-m hostile`.")


def pytest_collection(session: pytest.Session) -> None:
    """Each worker begins to import the test files elsewhere, so that one compiles what the others find on disk."""
    number, workers = os.environ.get("PYTEST_XDIST_WORKER", ""), int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    if not number or {Path(name).resolve() for name in session.config.args} != {Path(__file__).parent}:
        return
    files = sorted(Path(__file__).parent.rglob("test_*.py"))
    first = len(files) * int(number.removeprefix("gw")) // workers
    for path in files[first:]:
        with contextlib.suppress(Exception, pytest.skip.Exception):  # reported when it is collected
            _ = pytest.Module.from_parent(session, path=path).obj


def pytest_collection_finish() -> None:
    """What is loaded by now stays: the collector of cycles would look through it again and again.

    It looks seldom, too, which takes a twentieth of the suite's processor time less.
    """
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    """Check the first calls of each function in each test."""
    typechecks.renew()


@pytest.fixture(scope="session")
def plane() -> "Scene":
    """A horizontal plane through the origin that reaches 1 km each way."""
    from worlds import make_scene, make_surface

    return make_scene(make_surface(lambda x, y: 0 * x, size_m=2000.0, spacing_m=20.0))


@pytest.fixture(scope="session")
def pencil() -> "Antenna":
    """The paper's antenna: 2 deg in both planes, side lobes at -20 dB."""
    from beams import make_antenna

    return make_antenna(2.0, 2.0)


@dataclass(frozen=True)
class Done:
    """What a command left behind."""

    stdout: str
    stderr: str


@pytest.fixture
def cli(monkeypatch, capsys) -> Callable[..., Done]:
    """The command line in this process, which has the heavy libraries loaded already."""
    from sionna_radar.cli.app import main

    def call(*arguments: object, code: int | None = 0) -> Done:
        """Run a command that ends as wanted; one that is refused (2) says one error."""
        monkeypatch.setattr(sys, "argv", ["sionna-radar", *map(str, arguments)])
        monkeypatch.setattr(logging.getLogger("sionna_radar"), "handlers", [])  # those of before are closed
        with pytest.raises(SystemExit) as stop:
            main()
        captured = capsys.readouterr()
        assert code in (None, stop.value.code or 0), captured.err
        assert code != 2 or (captured.err.count("error:") == 1 and "Traceback" not in captured.err)
        return Done(captured.out, captured.err)

    return call


@pytest.fixture(scope="session")
def small(tmp_path_factory) -> Path:
    """A scenario file that is flown in a second."""
    from surveys import SMALL

    path = tmp_path_factory.mktemp("scenario") / "small.toml"
    path.write_text(SMALL)
    return path


@pytest.fixture
def unchecked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Types go unchecked, as outside the tests: the package's own checks must stop what is wrong."""
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are written, but stay blank: for tests that look at other results."""
    from blank_figures import leave_blank

    leave_blank(monkeypatch)


@pytest.fixture(scope="module")
def rough_errors():
    """Errors of maps are stated from the relief around a few heights: for tests that look at other results."""
    from sionna_radar.inference.terrain import covariance_fit

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(covariance_fit, "GROUP", 60)
        yield


@pytest.fixture(scope="module")
def sketched_rain():
    """Rain is known from fewer pulses, which takes less time: for tests that look at other results."""
    from sionna_radar.survey.sensors import sweeps

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sweeps, "VOLUME_PULSES", 64)
        patch.setattr(sweeps, "MOTION_PULSES", 128)
        yield


@pytest.fixture
def forgotten():
    """What an example registers is known to nobody after it."""
    from sionna_radar.scenario import parts
    from sionna_radar.scenario.registry import Registry

    registries = [thing for thing in vars(parts).values() if isinstance(thing, Registry)]
    yield
    for registry in registries:
        for name, entry in list(registry._entries.items()):
            if entry.origin != "sionna_radar":
                del registry._entries[name]
