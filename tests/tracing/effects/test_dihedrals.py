"""Dihedrals against their closed forms, and against the surface integral over one face."""

import numpy as np
import pytest

from beams import make_antenna, make_chirp
from corners import METAL, WAVELENGTH_M, corner, mirror_of, plate, rough_ground, wall_on_ground
from flights import make_pulses
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.surfaces.rough_surface import fresnel_reflection
from sionna_radar.tracing.effects.dihedrals import DihedralTracer, dihedrals_of
from sionna_radar.tracing.effects.mirrors import plane_mirrors
from sionna_radar.tracing.paths import BOUNCED
from worlds import make_scene

CHIRP = make_chirp()
RANGE_M = 50.0 * np.sqrt(2.0)
# Reflections of metal at 45 deg lose this much, in V and in H.
LOSS = {p: abs(fresnel_reflection(METAL, np.array([np.sqrt(0.5)]), p)[0]) ** 4 for p in "VH"}


def look(scene, antenna, **pose):
    pulses = make_pulses(incidence_deg=45.0, **({"position_m": (0.0, -50.0, 50.0)} | pose))
    tracer = DihedralTracer(dihedrals_of(plane_mirrors(scene, CHIRP)), antenna, CHIRP, RayCaster(scene.surfaces))
    return tracer.trace(pulses) if len(tracer) else None


def rcs_m2(paths, antenna):
    power = np.abs(paths.gain) ** 2
    return power * (4 * np.pi) ** 3 * RANGE_M**4 / (antenna.peak_gain**2 * WAVELENGTH_M**2)


@pytest.mark.parametrize("polarization", ["V", "H"])
@pytest.mark.parametrize("size_m", [0.05, 0.1])
def test_a_small_dihedral_has_the_cross_section_of_books(polarization, size_m):
    antenna = make_antenna(8.0, 8.0, polarization)
    paths = look(corner(size_m, size_m), antenna)
    book = 8 * np.pi * size_m**4 / WAVELENGTH_M**2
    # 0.1 m is a twentieth of the Fresnel zone's area: 0.02 dB.
    assert abs(10 * np.log10(rcs_m2(paths, antenna)[0] / (book * LOSS[polarization]))) < 0.03
    assert paths.delay_s[0] == pytest.approx(2 * RANGE_M / 299_792_458.0, rel=1e-12)
    assert paths.range_rate_mps[0] == pytest.approx(-10.0 / np.sqrt(2), rel=1e-9)
    assert paths.surface[0] == BOUNCED


@pytest.mark.parametrize("polarization", ["V", "H"])
def test_a_big_dihedral_is_the_radars_image_at_its_edge(polarization):
    antenna = make_antenna(2.0, 2.0, polarization)
    paths = look(corner(30.0, 60.0), antenna)
    image = antenna.peak_gain * WAVELENGTH_M / (4 * np.pi * 2 * RANGE_M) * np.sqrt(LOSS[polarization])
    assert abs(paths.gain[0]) == pytest.approx(image, rel=2e-3)
    # Both reflections turn H about; of V the upright and the level part once each.
    assert np.real(paths.gain[0]) * {"H": 1, "V": -1}[polarization] > 0.99 * image


def test_it_looks_back_wherever_the_radar_is():
    antenna = make_antenna(40.0, 40.0, "H")
    scene = corner(60.0, 60.0)
    for below_deg in (20.0, 45.0, 65.0):
        angle = np.deg2rad(below_deg)
        place = (0.0, -RANGE_M * np.cos(angle), RANGE_M * np.sin(angle))
        echo = look(scene, antenna, position_m=place)
        gain = antenna.gain(np.array([[np.cos(angle - np.pi / 4), 0.0, np.sin(np.pi / 4 - angle)]]))[0]
        image = gain * WAVELENGTH_M / (4 * np.pi * 2 * RANGE_M)
        assert abs(echo.gain[0]) == pytest.approx(image, rel=0.02)


@pytest.mark.parametrize(("roll_deg", "kept"), [(0.0, 1.0), (22.5, 0.5), (45.0, 0.0), (90.0, 1.0)])
def test_a_rolled_dihedral_turns_the_polarization(roll_deg, kept):
    """Rolled by t it reflects a linear wave turned by 2 t: cos^2 2 t stays co-polar, sin^2 2 t is cross-polar."""
    co = make_antenna(8.0, 8.0, "V")
    cross = type(co)(co.azimuth, co.elevation, "V", "cross")
    scene = corner(0.1, 0.1, roll_deg=roll_deg)
    whole = 8 * np.pi * 0.1**4 / WAVELENGTH_M**2
    for antenna, share in ((co, kept), (cross, 1 - kept)):
        paths = look(scene, antenna)
        got = 0.0 if len(paths) == 0 else rcs_m2(paths, antenna)[0]
        assert got / whole == pytest.approx(share, abs=0.012)


def surface_integral(turn_rad, size_m, length_m=None, beside_m=0.0):
    """Sum over one face of what the other one sends to it, by geometrical optics, back to the radar; both orders.

    With the radar's image in the first face the wave is known on the second one, where the first face sends it.
    """
    count, length_m = 1200, length_m or size_m
    place = (np.arange(count) + 0.5) / count
    level_way = np.array([0.0, -np.cos(turn_rad / 2), np.sin(turn_rad / 2)])
    upright_way = np.array([0.0, -np.sin(turn_rad / 2), np.cos(turn_rad / 2)])
    radar = np.array([beside_m, -50.0, 50.0])
    total = 0.0
    for first, second in ((level_way, upright_way), (upright_way, level_way)):
        normal = np.cross(first, [1.0, 0.0, 0.0])
        normal *= np.sign(normal @ second)
        image = radar - 2 * (radar @ normal) * normal
        along = length_m * ((np.arange(150) + 0.5) / 150 - 0.5)
        at = size_m * place[:, None, None] * second + along[:, None] * np.array([1.0, 0.0, 0.0])
        # Where the ray from the image to each place passes the first face.
        before, behind = at @ normal, image @ normal
        passes = image + (behind / (behind - before))[..., None] * (at - image)
        lit = (passes @ first > 0) & (passes @ first < size_m) & (np.abs(passes[..., 0]) < length_m / 2)
        points = at[lit]
        one, other = (np.linalg.norm(points - p, axis=-1) for p in (image, radar))
        own = np.cross(second, [1.0, 0.0, 0.0])
        cosine = np.abs((radar - points) @ own) / other
        wave = np.exp(-2j * np.pi / WAVELENGTH_M * (one + other - 2 * RANGE_M)) / (one * other)
        total += 1j / WAVELENGTH_M * np.sum(cosine * wave) * (size_m / count) * (length_m / 150)
    return total * 2 * RANGE_M


@pytest.mark.parametrize("turn_deg", [-0.6, -0.2, 0.0, 0.2, 0.6])
def test_faces_not_quite_at_right_angles_follow_the_surface_integral(turn_deg):
    antenna, size = make_antenna(20.0, 20.0, "H"), 0.4
    paths = look(corner(size, size, turn_rad=np.deg2rad(turn_deg)), antenna)
    image = antenna.peak_gain * WAVELENGTH_M / (4 * np.pi * 2 * RANGE_M)
    share = 0.0 if len(paths) == 0 else abs(paths.gain[0]) / image
    expected = abs(surface_integral(np.deg2rad(turn_deg), size))
    assert share == pytest.approx(expected, abs=0.02 * abs(surface_integral(0.0, size)))


@pytest.mark.parametrize(("depth_m", "length_m"), [(0.1, 0.1), (0.05, 0.3), (0.15, 0.08)])
def test_off_the_plane_across_its_edge_it_has_the_lobes_of_the_length_that_both_faces_share(depth_m, length_m):
    """Beyond the first null: a sinc of a length that shrinks by what rays go along the edge between the faces."""
    antenna, null_m = make_antenna(60.0, 60.0, "H"), WAVELENGTH_M / 2 / length_m * RANGE_M
    first = look(corner(depth_m, length_m), antenna)
    for nulls in (0.4, 0.75, 0.85, 1.5):
        beside_m = nulls * null_m
        paths = look(corner(depth_m, length_m), antenna, position_m=(beside_m, -50.0, 50.0))
        away = np.array([-beside_m, 50.0, -50.0])
        ahead = np.array([[RANGE_M, -beside_m, 0.0]]) / np.linalg.norm(away)
        gain = abs(paths.gain[0]) / antenna.gain(ahead)[0] / (abs(first.gain[0]) / antenna.peak_gain)
        expected = abs(surface_integral(0.0, depth_m, length_m, beside_m) / surface_integral(0.0, depth_m, length_m))
        assert 20 * np.log10(gain / expected) == pytest.approx(0.0, abs=0.15)


def test_what_stands_before_it_hides_it():
    scene = corner(1.0, 1.0)
    screen = plate("screen", [[-1, -26, 24], [1, -26, 24], [1, -24, 26], [-1, -24, 26]], "metal")
    hidden = make_scene(*scene.surfaces, screen, materials=scene.materials)
    assert len(look(scene, make_antenna(8.0, 8.0))) == 1
    assert len(look(hidden, make_antenna(8.0, 8.0))) == 0


def test_a_wall_on_smooth_ground_is_one_and_on_rough_ground_none():
    antenna = make_antenna(4.0, 4.0)
    smooth = look(wall_on_ground(north_m=0.0, ground=mirror_of()), antenna)
    assert len(smooth) == 1
    np.testing.assert_allclose(smooth.hit_m[0], 0.0, atol=1e-9)
    assert look(wall_on_ground(north_m=0.0, ground=rough_ground()), antenna) is None
    # Rough by a millimetre, the ground keeps exp(-(2 k s cos)^2) of the power.
    rough = look(wall_on_ground(north_m=0.0, ground=mirror_of(rms_height_m=3e-4)), antenna)
    left = np.exp(-((4 * np.pi / WAVELENGTH_M * 3e-4) ** 2) / 2)
    assert abs(rough.gain[0]) ** 2 / abs(smooth.gain[0]) ** 2 == pytest.approx(left, rel=1e-6)
