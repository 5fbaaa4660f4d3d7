"""Point targets against the radar equation, seen and hidden."""

import numpy as np
import pytest

from beams import make_antenna, make_chirp
from flights import make_pulses
from sionna_radar.scene.model import Surface, Target
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.tracing.effects.targets import trace_targets
from sionna_radar.tracing.engines.beam.beam import BeamEngine
from sionna_radar.tracing.paths import FIRST_OBSTACLE
from sionna_radar.tracing.tracer import Tracer
from worlds import make_scene, make_surface

C = 299_792_458.0
WAVELENGTH_M = C / 77e9


@pytest.fixture(scope="module")
def far_below():
    """Ground too low to hide anything."""
    return RayCaster([make_surface(lambda x, y: 0 * x - 5000.0, spacing_m=100.0)])


def wall(x_from, x_to, y, height) -> Surface:
    """A vertical wall across the view to the north."""
    vertices = np.array([[x_from, y, 0], [x_to, y, 0], [x_to, y, height], [x_from, y, height]], dtype=float)
    return Surface(name="wall", vertices_m=vertices, faces=np.array([[0, 1, 2], [0, 2, 3]]), material="ground")


def test_delay_range_rate_and_place(far_below):
    target = Target(position_m=(30.0, 0.0, 10.0), rcs_m2=1.0)
    pulses = make_pulses(3, velocity_mps=(5.0, 0.0, 0.0), first=4)
    paths = trace_targets([target], pulses, make_antenna(40.0, 40.0), make_chirp(), far_below)
    np.testing.assert_array_equal(paths.pulse, [4, 5, 6])
    np.testing.assert_allclose(paths.delay_s, 2 * 50.0 / C, rtol=1e-12)
    np.testing.assert_allclose(paths.range_rate_mps, -5.0 * 30 / 50)  # approaching
    np.testing.assert_allclose(paths.hit_m, np.tile(target.position_m, (3, 1)))
    np.testing.assert_array_equal(paths.surface, FIRST_OBSTACLE)
    assert np.all(np.isnan(paths.incidence_rad))


def test_a_target_on_the_terrain_is_seen_and_one_behind_a_wall_is_not():
    targets = (
        Target(position_m=(0.0, 30.0, 0.0), rcs_m2=1.0),  # on the ground before the wall
        Target(position_m=(0.0, 60.0, 0.0), rcs_m2=2.0),  # on the ground in its shadow
        Target(position_m=(0.0, 60.0, 35.0), rcs_m2=4.0),  # above the shadow
        Target(position_m=(40.0, 60.0, 0.0), rcs_m2=8.0),  # beside it
        Target(position_m=(0.0, 30.0, -1.0), rcs_m2=16.0),  # buried
    )
    scene = make_scene(make_surface(lambda x, y: 0 * x), wall(-20, 20, 40, 30), targets=targets)
    antenna, chirp, pulses = make_antenna(50.0, 50.0), make_chirp(), make_pulses(2, incidence_deg=45.0)
    caster = RayCaster(scene.surfaces)
    seen = trace_targets(targets, pulses, antenna, chirp, caster)
    expected = [targets[k].position_m for k in (0, 2, 3)] * 2
    np.testing.assert_allclose(seen.hit_m, expected)

    surfaces = BeamEngine(scene, antenna, chirp, 1, 64, 0.05)
    everything = Tracer(surfaces, scene, antenna, chirp, caster).trace(pulses)
    assert np.all(np.diff(everything.pulse) >= 0)
    assert np.sum(everything.surface <= FIRST_OBSTACLE) == 6
    assert len(everything) == 6 + len(surfaces.trace(pulses))


def test_targets_on_rough_ground_are_seen():
    """A target on a slope of triangles touches the mesh, which must not hide it."""
    caster = RayCaster([make_surface(lambda x, y: 0.2 * x + 0.1 * y)])
    place = np.random.default_rng(2).uniform(-20, 20, (200, 2))
    targets = [Target(position_m=(x, y, 0.2 * x + 0.1 * y), rcs_m2=1.0) for x, y in place]
    assert len(trace_targets(targets, make_pulses(1), make_antenna(50.0, 50.0), make_chirp(), caster)) == 200
