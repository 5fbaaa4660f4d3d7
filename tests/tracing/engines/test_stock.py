"""The beam engine against Sionna's stock path solver, which samples the whole sphere."""

from dataclasses import replace

import numpy as np
import pytest

from beams import make_antenna, make_chirp
from flights import make_pulses
from sionna_radar.flight.frames import whisk_broom_from_antenna, world_from_body
from sionna_radar.scenario.tracing import TracingTable
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.tracing.build import EngineInputs, build_engine
from sionna_radar.tracing.engines.beam.beam import BeamEngine
from sionna_radar.tracing.engines.gamma.facets import GammaEngine
from sionna_radar.tracing.engines.persistent.persistent import PersistentEngine
from sionna_radar.tracing.engines.stock import PathSolverEngine
from sionna_radar.tracing.paths import SampledBeams
from worlds import make_scene, make_surface

C = 299_792_458.0
PULSES = 12
SAMPLES = 100_000


def hill(x, y):
    return 8 * np.exp(-((x - 5) ** 2 + (y - 30) ** 2) / 300) + 0.05 * x


@pytest.fixture(scope="module")
def hills():
    return make_scene(make_surface(hill, size_m=800.0))


def scattered():
    """Poses spread a little, so that the solver's lattice of rays falls anew in each: independent repeats."""
    random = np.random.default_rng(8)
    position = np.array([0.0, 0.0, 50.0]) + random.uniform(-2, 2, (PULSES, 3))
    pulses = make_pulses(PULSES, position_m=position, velocity_mps=(2.0, 9.0, 1.0), first=3)
    euler = np.column_stack([np.zeros((PULSES, 2)), random.uniform(-0.3, 0.3, PULSES)])
    R = world_from_body(euler) @ whisk_broom_from_antenna(np.deg2rad(30), random.uniform(-0.2, 0.2, PULSES))
    pose = replace(pulses.true, R_world_antenna=R)
    return replace(pulses, true=pose, measured=pose)


def power(paths):
    return np.bincount(paths.pulse - 3, weights=np.abs(paths.gain.astype(complex)) ** 2, minlength=PULSES)


@pytest.mark.parametrize(("name", "polarization"), [("plane", "V"), ("hills", "V"), ("hills", "H")])
def test_mean_power_agrees_with_the_stock_solver(request, name, polarization):
    scene = request.getfixturevalue(name)
    antenna, chirp, pulses = make_antenna(20.0, 20.0, polarization), make_chirp(), scattered()
    beam = power(BeamEngine(scene, antenna, chirp, 1, 4096, 0.05).trace(pulses))
    stock = power(PathSolverEngine(scene, antenna, chirp, 1, samples=SAMPLES).trace(pulses))
    # Both see the same poses, so the ratio of each pair is one measurement.
    ratio = beam / stock
    error = ratio.std(ddof=1) / np.sqrt(PULSES)
    assert error < 0.002
    assert abs(ratio.mean() - 1) < 4 * error


def test_the_stock_table_holds_the_geometry(hills):
    pulses = scattered().rows(slice(0, 3))
    paths = PathSolverEngine(hills, make_antenna(20.0, 20.0), make_chirp(), 1, samples=SAMPLES).trace(pulses)
    away = paths.hit_m - pulses.true.position_m[paths.pulse - 3]
    range_m = np.linalg.norm(away, axis=1)
    assert np.all(np.diff(paths.pulse) >= 0)
    assert np.all(np.bincount(paths.pulse - 3) > 1000)
    np.testing.assert_allclose(paths.delay_s, 2 * range_m / C, rtol=1e-5)
    np.testing.assert_allclose(paths.range_rate_mps, -(away / range_m[:, None]) @ [2.0, 9.0, 1.0], atol=1e-4)
    np.testing.assert_array_equal(paths.surface, 0)


def test_incidence_over_a_plane(plane):
    paths = PathSolverEngine(plane, make_antenna(20.0, 20.0), make_chirp(), 1, samples=SAMPLES).trace(make_pulses())
    near = paths.incidence_rad < np.deg2rad(80)
    range_m = C * paths.delay_s / 2
    np.testing.assert_allclose(np.cos(paths.incidence_rad[near]), 50.0 / range_m[near], atol=1e-4)


@pytest.mark.parametrize(
    ("table", "kind"),
    [
        (TracingTable(engine="path_solver"), PathSolverEngine),
        (TracingTable(engine="sionna", speckle="per_pulse"), BeamEngine),
        (TracingTable(engine="gamma"), GammaEngine),
        (TracingTable(), PersistentEngine),
        (TracingTable(scatterers_per_m2=0.01), PersistentEngine),
    ],
)
def test_a_scenario_names_its_engine(plane, pencil, table, kind):
    given = EngineInputs(
        tracing=table,
        scene=plane,
        antenna=pencil,
        chirp=make_chirp(),
        seed=1,
        caster=RayCaster(plane.surfaces),
        region_m=np.array([[-50.0] * 3, [50.0] * 3]),
        looks=SampledBeams(
            position_m=np.array([[0.0, 0.0, 50.0]]),
            R_world_antenna=world_from_body(np.zeros((1, 3))) @ whisk_broom_from_antenna(0.0, np.zeros(1)),
            range_m=np.array([50.0]),
            beam=np.zeros(1, dtype=np.int64),
        ),
    )
    assert isinstance(build_engine(table, given), kind)
