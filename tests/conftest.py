"""Scenes, pulses, antennas and the command line, which the tests of several stages share."""

import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

from sionna_radar.cli.app import main
from sionna_radar.flight.frames import whisk_broom_from_antenna, world_from_body
from sionna_radar.flight.pulses import Pose, Pulses
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.radar.taylor_array import taylor_cut
from sionna_radar.scene.mesh import mesh_of
from sionna_radar.scene.model import Scene, Surface
from sionna_radar.surfaces.backscatter import ConstantGammaBackscatter

GAMMA = 0.01
SMALL = """
seed = 5
[terrain]
kind = "flat"
size_m = [300.0, 300.0]
[platform]
altitude_m = 50.0
speed_mps = 10.0
length_m = 10.0
start_m = [-60.0, 0.0]
[radar]
snr_db = 30.0
[tracing]
paths_per_pulse = 64
"""

# The workers share the cores; they and the programs they start take this over.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# How long an example takes says more of the machine than of the code.
settings.register_profile("any machine", deadline=None)
settings.load_profile("any machine")


def make_chirp(**changes: object) -> Chirp:
    """Return the sweep of the paper's Table 2, with what the test changes of it."""
    values = {"carrier_hz": 77e9, "bandwidth_hz": 500e6, "rate_hz": 360.0, "samples": 1024}
    return Chirp(**(values | changes))


def make_antenna(azimuth_deg: float, elevation_deg: float, polarization: str = "V") -> Antenna:
    azimuth, elevation = (taylor_cut(float(np.deg2rad(w)), -20.0) for w in (azimuth_deg, elevation_deg))
    return Antenna(azimuth, elevation, polarization)


def make_surface(
    height: Callable[[np.ndarray, np.ndarray], np.ndarray],
    *,
    size_m: float = 400.0,
    spacing_m: float = 2.0,
    centre_m: tuple[float, float] = (0.0, 0.0),
    name: str = "ground",
) -> Surface:
    """Return a square of ground with a height for each place of the plan."""
    count = round(size_m / spacing_m) + 1
    west, south = np.array(centre_m) - size_m / 2
    grid = Grid(west_m=west, south_m=south, spacing_m=spacing_m, columns=count, rows=count)
    x, y = grid.centres_m.T
    heights = np.broadcast_to(height(x, y), x.shape).astype(float).reshape(grid.shape)
    vertices, faces = mesh_of(Raster(grid=grid, height_m=heights))
    return Surface(name=name, vertices_m=vertices, faces=faces, material="ground")


def make_scene(*surfaces: Surface, gamma: float = GAMMA, targets: tuple = ()) -> Scene:
    return Scene(
        surfaces=surfaces,
        materials={"ground": ConstantGammaBackscatter(gamma)},
        targets=targets,
        ground_material="ground",
        georeference=None,
    )


def make_pulses(
    count: int = 1,
    *,
    incidence_deg: float = 0.0,
    scan_deg: float | np.ndarray = 0.0,
    position_m: tuple[float, float, float] | np.ndarray = (0.0, 0.0, 50.0),
    velocity_mps: tuple[float, float, float] = (0.0, 10.0, 0.0),
    heading_deg: float = 0.0,
    first: int = 0,
) -> Pulses:
    """Return pulses of a level platform that looks at an angle from nadir, north unless turned."""
    scan_rad = np.broadcast_to(np.deg2rad(scan_deg), (count,)).astype(float)
    euler = np.tile([0.0, 0.0, np.deg2rad(heading_deg)], (count, 1))
    pose = Pose(
        position_m=np.broadcast_to(position_m, (count, 3)).astype(float),
        velocity_mps=np.tile(np.asarray(velocity_mps, dtype=float), (count, 1)),
        R_world_antenna=world_from_body(euler) @ whisk_broom_from_antenna(np.deg2rad(incidence_deg), scan_rad),
    )
    index = np.arange(first, first + count)
    return Pulses(index=index, time_s=index / 360.0, scan_rad=scan_rad, true=pose, measured=pose)


def plane_power(
    antenna: Antenna, height_m: float, incidence_deg: float, scan_deg: float = 0.0, gamma: float = GAMMA
) -> float:
    """Received over sent power above a plane: the radar equation summed over azimuth and elevation angles.

    P = lambda^2 / (4 pi)^3 * integral of G^2 sigma0 / r^4 dA, sigma0 = gamma cos t, dA = r^2 dOmega / cos t.
    Written apart from `sionna_radar.radar.equation`: other coordinates, other nodes.
    """
    width = max(antenna.beamwidths_rad)
    near, far = 3.0 * width, np.pi / 2
    grid = np.concatenate(
        [np.linspace(-far, -near, 350)[:-1], np.linspace(-near, near, 601), np.linspace(near, far, 350)[1:]]
    )
    azimuth, elevation = np.meshgrid(grid, grid, indexing="ij")
    x, y, z = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)
    gain = antenna.gain(np.stack([x, y, z], axis=-1).reshape(-1, 3)).reshape(x.shape)
    # Downward components of boresight, left and up under a whisk-broom scan.
    a, b = np.deg2rad([incidence_deg, scan_deg])
    down = np.cos(a) * np.cos(b) * x + np.sin(b) * y - np.sin(a) * np.cos(b) * z
    range_m = height_m / np.maximum(down, 1e-4)
    # sigma0 dA / r^4 = gamma down * r^2 dOmega / down / r^4, and dOmega = cos(elevation) d azimuth d elevation.
    density = np.where(down > 1e-4, gain**2 * gamma / range_m**2 * np.cos(elevation), 0.0)
    wavelength = 299_792_458.0 / 77e9
    return wavelength**2 / (4 * np.pi) ** 3 * float(np.trapezoid(np.trapezoid(density, grid, axis=1), grid))


@pytest.fixture(scope="session")
def plane_power_of() -> Callable[..., float]:
    return plane_power


@pytest.fixture(scope="session")
def chirp_of() -> Callable[..., Chirp]:
    return make_chirp


@pytest.fixture(scope="session")
def antenna_of() -> Callable[..., Antenna]:
    return make_antenna


@pytest.fixture(scope="session")
def surface_of() -> Callable[..., Surface]:
    return make_surface


@pytest.fixture(scope="session")
def scene_of() -> Callable[..., Scene]:
    return make_scene


@pytest.fixture(scope="session")
def looking() -> Callable[..., Pulses]:
    return make_pulses


@pytest.fixture(scope="session")
def plane() -> Scene:
    """A horizontal plane through the origin that reaches 1 km each way."""
    return make_scene(make_surface(lambda x, y: 0 * x, size_m=2000.0, spacing_m=5.0))


@pytest.fixture(scope="session")
def pencil() -> Antenna:
    """The paper's antenna: 2 deg in both planes, side lobes at -20 dB."""
    return make_antenna(2.0, 2.0)


@dataclass(frozen=True)
class Done:
    """What a command left behind."""

    returncode: int
    stdout: str
    stderr: str


@pytest.fixture
def cli(monkeypatch, capsys) -> Callable[..., Done]:
    """The command line in this process, which has the heavy libraries loaded already."""

    def call(*arguments: object) -> Done:
        monkeypatch.setattr(sys, "argv", ["sionna-radar", *map(str, arguments)])
        with pytest.raises(SystemExit) as stop:
            main()
        captured = capsys.readouterr()
        return Done(stop.value.code or 0, captured.out, captured.err)

    return call


@pytest.fixture(scope="session")
def small(tmp_path_factory) -> Path:
    """A scenario file that is flown in a second."""
    path = tmp_path_factory.mktemp("scenario") / "small.toml"
    path.write_text(SMALL)
    return path
