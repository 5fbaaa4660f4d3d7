"""Two bounces, one of them on a mirror, against sums over the ground, and against Sionna's stock solver."""

import numpy as np
import pytest

from beams import make_antenna, make_chirp
from corners import WAVELENGTH_M, mirror_of, plate, rough_ground, wall_on_ground
from flights import make_pulses
from sionna_radar.tracing.engines.beam.beam import BeamEngine
from sionna_radar.tracing.engines.persistent.persistent import PersistentEngine
from sionna_radar.tracing.engines.stock import PathSolverEngine
from sionna_radar.tracing.paths import BOUNCED, Paths
from sionna_radar.tracing.sionna.pattern import mi, sionna_angles
from worlds import GAMMA, make_scene

# isort: split
# Loads libLLVM, which the imports above have selected.
import sionna.rt as rt

C = 299_792_458.0
CHIRP = make_chirp()
RADAR = np.array([0.0, 0.0, 50.0])
UP, NORTH = np.eye(3)[2], np.eye(3)[1]


def engine(scene, antenna, kind="beam", bounces=2, paths=1024, per_m2=2.0):
    if kind == "beam":
        return BeamEngine(scene, antenna, CHIRP, 1, paths, 0.05, bounces=bounces)
    return PersistentEngine(scene, antenna, CHIRP, 1, per_m2, bounces=bounces)


def image_of(radar_m, wall_m):
    return radar_m * [1, -1, 1] + np.array([0, 2 * wall_m, 0])


def bounced(paths):
    return paths.rows(np.flatnonzero(paths.surface == BOUNCED))


def from_mirror(paths):
    """Return those that arrive from a mirror that looks south, and those that arrive from the ground."""
    upright = paths.hit_m[:, 2] > 1e-3
    return paths.rows(np.flatnonzero(upright)), paths.rows(np.flatnonzero(~upright))


def ground_sum(antenna, pulses, wall_m):
    """Sum the power of two bounces, both orders, over the ground, by the image of the radar in the wall."""
    x, y = np.meshgrid(
        np.linspace(-25, 25, 501), np.linspace(20, wall_m, 641)[:-1] + (wall_m - 20) / 1280, indexing="ij"
    )
    place = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3)
    out, back = place - RADAR, place - image_of(RADAR, wall_m)
    r1, r2 = np.linalg.norm(out, axis=1), np.linalg.norm(back, axis=1)
    R = pulses.true.R_world_antenna[0]
    gain = antenna.gain(out / r1[:, None] @ R) * antenna.gain(back * [1, -1, 1] / r2[:, None] @ R)
    sigma = GAMMA * np.sqrt(50.0 / r1 * 50.0 / r2)
    power = 4 * WAVELENGTH_M**2 * gain * sigma / ((4 * np.pi) ** 3 * r1**2 * r2**2)
    return power.sum() * (50 / 500) * (wall_m - 20) / 640


@pytest.mark.parametrize(
    ("kind", "polarization", "wall_m"), [("beam", "V", 52.0), ("beam", "H", 55.0), ("persistent", "H", 52.0)]
)
def test_power_is_the_sum_over_the_ground(kind, polarization, wall_m):
    antenna, pulses = make_antenna(6.0, 6.0, polarization), make_pulses(10, incidence_deg=45.0)
    paths = bounced(engine(wall_on_ground(wall_m), antenna, kind, per_m2=8.0).trace(pulses))
    one, other = from_mirror(paths)
    # Both orders of a place add up before the powers of places do.
    power = np.sum(np.abs(one.gain.astype(complex) + other.gain) ** 2) / len(pulses)
    assert abs(10 * np.log10(power / ground_sum(antenna, pulses, wall_m))) < 0.1


@pytest.mark.parametrize("kind", ["beam", "persistent"])
def test_both_orders_are_one_field_and_delays_are_exact(kind):
    wall_m = 53.0
    pulses = make_pulses(3, incidence_deg=45.0, velocity_mps=(3.0, 9.0, -2.0), first=7)
    one, other = from_mirror(bounced(engine(wall_on_ground(wall_m), make_antenna(6.0, 6.0), kind).trace(pulses)))
    assert len(one) == len(other) > 200
    np.testing.assert_array_equal(one.gain, other.gain)
    # Together twice the field of one, four times its power.
    np.testing.assert_array_equal(one.delay_s, other.delay_s)
    through = other.hit_m - image_of(RADAR, wall_m)
    total_m = np.linalg.norm(other.hit_m - RADAR, axis=1) + np.linalg.norm(through, axis=1)
    np.testing.assert_allclose(C * one.delay_s, total_m, rtol=1e-14)
    legs_m = np.linalg.norm(one.hit_m - RADAR, axis=1) + np.linalg.norm(one.hit_m - other.hit_m, axis=1)
    np.testing.assert_allclose(legs_m, np.linalg.norm(through, axis=1), rtol=1e-12)
    np.testing.assert_allclose(one.hit_m[:, 1], wall_m, atol=1e-9)
    # The range rate is the rate of half the way: the image in the wall moves south as the radar moves north.
    step = 1e-3
    moved = RADAR + step * np.array([3.0, 9.0, -2.0])
    image = image_of(moved, wall_m)
    later_m = np.linalg.norm(other.hit_m - moved, axis=1) + np.linalg.norm(other.hit_m - image, axis=1)
    np.testing.assert_allclose(one.range_rate_mps, (later_m - total_m) / 2 / step, atol=1e-3)


def test_ground_and_wall_change_their_parts():
    """A dull wall over mirror ground: the same sum with the picture turned by a right angle."""
    antenna, pulses = make_antenna(6.0, 6.0), make_pulses(6, incidence_deg=45.0)
    dull = wall_on_ground(50.0, ground=mirror_of(), wall=rough_ground())
    own = wall_on_ground(50.0)
    powers = [np.sum(np.abs(bounced(engine(s, antenna).trace(pulses)).gain) ** 2) for s in (dull, own)]
    assert abs(10 * np.log10(powers[0] / powers[1])) < 0.15


def test_single_bounces_stay_the_same_bits():
    pulses = make_pulses(4, incidence_deg=45.0)
    scene, antenna = wall_on_ground(), make_antenna(4.0, 4.0)
    for kind in ("beam", "persistent"):
        alone = engine(scene, antenna, kind, bounces=1).trace(pulses)
        both = engine(scene, antenna, kind).trace(pulses)
        single = both.rows(np.flatnonzero(both.surface != BOUNCED))
        for name in ("pulse", "delay_s", "gain", "range_rate_mps", "hit_m", "surface"):
            np.testing.assert_array_equal(getattr(single, name), getattr(alone, name))


@pytest.mark.parametrize("kind", ["beam", "persistent"])
def test_blocks_change_nothing(kind):
    pulses = make_pulses(6, incidence_deg=45.0, first=20)
    traced = engine(wall_on_ground(), make_antenna(4.0, 4.0), kind)
    whole = traced.trace(pulses)
    parts = Paths.concatenate([traced.trace(pulses.rows(slice(i, i + 2))) for i in (0, 2, 4)])
    for name in ("pulse", "delay_s", "gain", "hit_m"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(parts, name))


def test_phases_are_those_of_one_surface():
    """A scatterer has one phase for all pulses, and the same by way of the mirror as straight (R = -1 in H)."""
    position = np.array([[0.0, 0.01 * i, 50.0] for i in range(3)])
    paths = engine(wall_on_ground(), make_antenna(4.0, 4.0, "H"), "persistent").trace(
        make_pulses(3, incidence_deg=45.0, position_m=position)
    )
    single = paths.rows(np.flatnonzero(paths.surface == 0))
    double = from_mirror(bounced(paths))[1]
    double = double.rows(np.flatnonzero(double.hit_m[:, 1] > 40.0))
    phase = {tuple(p): np.angle(g) for p, g in zip(single.hit_m, single.gain, strict=True)}
    same = [(phase.get(tuple(p)), g) for p, g in zip(double.hit_m.astype(np.float32), double.gain, strict=True)]
    turned = np.array([g * np.exp(-1j * p) for p, g in same if p is not None])
    turned /= np.abs(turned)
    assert len(turned) > 100
    assert np.max(np.abs(turned - turned[0])) < 0.05


def test_every_leg_can_be_hidden():
    antenna, pulses = make_antenna(4.0, 4.0), make_pulses(2, incidence_deg=45.0)
    scene = wall_on_ground(55.0)
    # Upright screens, before the wall, that end where only low or only high rays pass.
    low = plate("low", [[-60, 54.5, 0], [-60, 54.5, 3], [60, 54.5, 3], [60, 54.5, 0]], "dark")
    materials = scene.materials | {"dark": rough_ground(1e-9)}
    free = bounced(engine(scene, antenna).trace(pulses))
    kept = bounced(engine(make_scene(*scene.surfaces, low, materials=materials), antenna).trace(pulses))
    upright = kept.rows(np.flatnonzero(kept.hit_m[:, 2] > 1e-3))
    assert 0 < len(kept) < len(free)
    assert free.hit_m[free.hit_m[:, 2] > 1e-3, 2].min() < 0.5
    # From 3 m above the wall's foot on, seen over the screen half a metre before it.
    assert upright.hit_m[:, 2].min() > 2.4


def stock_power(scene, antenna, pulses):
    """Return the power of radar, mirror, ground, radar by Sionna's solver and its own metal."""
    solver = PathSolverEngine(scene, antenna, CHIRP, 1, samples=1)
    world = solver._sionna.rt_scene
    world.objects["surface-1"].radio_material = rt.RadioMaterial(
        "metal-wall", relative_permittivity=1.0, conductivity=1e7, scattering_coefficient=0.0
    )
    for device in solver._devices:
        device.position = mi.Point3f(*RADAR.tolist())
        device.orientation = mi.Point3f(*sionna_angles(pulses.true.R_world_antenna[:1])[0].tolist())
    found = solver._solver(
        world,
        max_depth=2,
        samples_per_src=400_000,
        max_num_paths_per_src=500_000,
        los=False,
        specular_reflection=True,
        diffuse_reflection=True,
        refraction=False,
        seed=5,
    )
    first, second = found.interactions.numpy().reshape(2, -1)
    gain = (found.a[0].numpy() + 1j * found.a[1].numpy()).ravel()
    return np.sum(np.abs(gain[(first == rt.InteractionType.SPECULAR) & (second == rt.InteractionType.DIFFUSE)]) ** 2)


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


@pytest.mark.parametrize("polarization", ["V", "H"])
def test_the_stock_solver_agrees_on_one_order(polarization):
    """Sionna traces mirror first, ground last; it differs in what it takes for granted of the ground, path by path.

    It scatters by the incidence of the arriving ray alone (we by the geometric mean of both), and keeps of the field
    what is left across the leaving ray: of a vertical one, at 45 deg, nothing (we keep its amplitude in the plane).
    """
    wall_m, R = 60.0, make_pulses(incidence_deg=45.0).true.R_world_antenna[0]
    scene, antenna = wall_on_ground(wall_m), make_antenna(20.0, 20.0, polarization)
    pulses = make_pulses(4, incidence_deg=45.0)
    paths = from_mirror(bounced(engine(scene, antenna, paths=6_000).trace(pulses)))[1]
    away, through = paths.hit_m - RADAR, paths.hit_m - image_of(RADAR, wall_m)
    r1, r2 = np.linalg.norm(away, axis=1), np.linalg.norm(through, axis=1)
    out, k_in = unit(away), unit(through)
    received = antenna.fields(out @ R)[1] @ R.T
    sent = antenna.fields(k_in * [1, -1, 1] @ R)[0] @ R.T
    arriving = 2 * (sent @ NORTH)[:, None] * NORTH - sent
    h_in, h_out = unit(np.cross(k_in, UP)), unit(np.cross(out, UP))
    h_out *= np.sign(np.sum(h_in * h_out, axis=1))[:, None]
    parts = ((h_in, h_out), (np.cross(k_in, h_in), np.cross(out, h_out)))
    ours = sum(np.sum(arriving * i, axis=1) * np.sum(received * o, axis=1) for i, o in parts)
    theirs = np.sum(received * arriving, axis=1)
    power = np.sum(np.abs(paths.gain) ** 2 * np.sqrt(r1 / r2) * (theirs / ours) ** 2) / len(pulses)
    assert abs(10 * np.log10(power / stock_power(scene, antenna, pulses))) < {"H": 0.05, "V": 0.2}[polarization]
