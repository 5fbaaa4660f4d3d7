"""Mirror reflections against the image of the radar."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.special import fresnel

from beams import make_antenna, make_chirp
from flights import make_pulses
from sionna_radar.radar.antenna import Antenna
from sionna_radar.scene.model import Scene, Surface
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.surfaces.backscatter import ConstantGammaBackscatter
from sionna_radar.surfaces.permittivity import building_permittivity
from sionna_radar.surfaces.radar_material import Mirror, RadarMaterial
from sionna_radar.surfaces.rough_surface import fresnel_reflection
from sionna_radar.tracing.effects.mirrors import MirrorTracer, patches_of
from sionna_radar.tracing.engines.beam.beam import BeamEngine
from sionna_radar.tracing.tracer import Tracer
from worlds import make_scene, make_surface

C = 299_792_458.0
WAVELENGTH_M = C / 77e9
METAL = building_permittivity("metal", 77e9)


def shiny(permittivity=METAL, rms_height_m=0.0) -> RadarMaterial:
    dull = ConstantGammaBackscatter(1e-3)
    mirror = Mirror(permittivity=permittivity, rms_height_m=rms_height_m, frequency_hz=77e9)
    return RadarMaterial(vertical=dull, horizontal=dull, mirror=mirror)


METAL_AMPLITUDE = shiny().mirror.amplitude


@pytest.fixture(scope="module")
def wide() -> Antenna:
    """A beam so wide that its gain is that of its peak over every plate here."""
    return make_antenna(40.0, 40.0)


def rectangle(length_m, width_m) -> Surface:
    x, y = length_m / 2, width_m / 2
    corners = np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]])
    return Surface(name="plate", vertices_m=corners, faces=np.array([[0, 1, 2], [0, 2, 3]]), material="ground")


def surface_over(height, size_m, spacing_m) -> Surface:
    edge = np.linspace(-size_m / 2, size_m / 2, round(size_m / spacing_m) + 1)
    x, y = np.meshgrid(edge, edge, indexing="ij")
    n = len(edge)
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.vstack([np.column_stack([corner, corner + n, corner + n + 1]),
                       np.column_stack([corner, corner + n + 1, corner + 1])])  # fmt: skip
    vertices = np.column_stack([x.ravel(), y.ravel(), height(x, y).ravel()])
    return Surface(name="ground", vertices_m=vertices, faces=faces, material="ground")


def scene_with(*surfaces, material=None) -> Scene:
    return make_scene(*surfaces, materials={"ground": material or shiny()})


def mirrors(scene, antenna, chirp) -> MirrorTracer:
    return MirrorTracer(scene, antenna, chirp, RayCaster(scene.surfaces))


@pytest.mark.parametrize("polarization", ["V", "H"])
@pytest.mark.parametrize("height_m", [10.0, 50.0, 120.0])
def test_a_big_metal_plate_is_the_radars_image(height_m, polarization):
    antenna = make_antenna(2.0, 2.0, polarization)
    plate = scene_with(make_surface(lambda x, y: 0 * x, size_m=20.0))
    velocity = (1.0, 2.0, -3.0)
    paths = mirrors(plate, antenna, make_chirp()).trace(
        make_pulses(3, position_m=(1.0, 2.0, height_m), velocity_mps=velocity, first=5)
    )
    np.testing.assert_array_equal(paths.pulse, [5, 6, 7])
    friis = (antenna.peak_gain * WAVELENGTH_M / (4 * np.pi * 2 * height_m)) ** 2
    assert 10 * np.log10(np.abs(paths.gain[0]) ** 2 / friis) == pytest.approx(0.0, abs=0.01)
    np.testing.assert_allclose(paths.hit_m, np.tile([1.0, 2.0, 0.0], (3, 1)), atol=1e-9)
    np.testing.assert_allclose(paths.delay_s, 2 * height_m / C, rtol=1e-12)
    np.testing.assert_allclose(paths.range_rate_mps, -3.0)
    np.testing.assert_array_equal(paths.incidence_rad, 0.0)


def test_roughness_and_medium_weaken_it(pencil):
    plate = make_surface(lambda x, y: 0 * x, size_m=20.0)
    glass = building_permittivity("glass", 77e9)
    levels = [
        20 * np.log10(abs(mirrors(scene_with(plate, material=m), pencil, make_chirp()).trace(make_pulses(1)).gain[0]))
        for m in (shiny(), shiny(glass), shiny(glass, 0.0005))
    ]
    fresnel_db = 20 * np.log10(abs((np.sqrt(glass) - 1) / (np.sqrt(glass) + 1)))
    assert levels[1] - levels[0] == pytest.approx(fresnel_db, abs=0.01)
    k_s = 2 * np.pi / WAVELENGTH_M * 0.0005
    assert levels[2] - levels[1] == pytest.approx(-10 * np.log10(np.e) * (2 * k_s) ** 2, abs=1e-6)


def test_coherent_and_diffuse_power_do_not_exceed_what_a_smooth_surface_reflects():
    """Off the mirror, small perturbation takes what the coherent reflection loses, to first order."""
    smooth = abs(Mirror(permittivity=4 - 0.1j, rms_height_m=0.0, frequency_hz=77e9).amplitude)
    rougher = [abs(Mirror(permittivity=4 - 0.1j, rms_height_m=s, frequency_hz=77e9).amplitude) for s in (1e-4, 1e-3)]
    assert smooth == pytest.approx(abs(fresnel_reflection(4 - 0.1j, np.ones(1), "V")[0]))
    assert smooth > rougher[0] > rougher[1]


def coherent_sum(paths) -> complex:
    """What the paths of one pulse add up to at the carrier."""
    return complex(np.sum(paths.gain * np.exp(-2j * np.pi * np.mod(77e9 * paths.delay_s, 1.0))))


def echo_of(surface, antenna, chirp, pulses, range_m) -> complex:
    """The echo over that of an endless metal plane at that range, seen with the peak gain."""
    endless = antenna.peak_gain * WAVELENGTH_M / (8 * np.pi * range_m) * METAL_AMPLITUDE
    turn = np.exp(-4j * np.pi * np.mod(range_m / WAVELENGTH_M, 1.0))
    return coherent_sum(mirrors(scene_with(surface), antenna, chirp).trace(pulses)) / (endless * turn)


def fresnel_between(low_m, high_m, range_m) -> complex:
    """The share of an endless strip's wave that passes between two lines, by Fresnel integrals."""
    scale = np.sqrt(4 / (WAVELENGTH_M * range_m))
    (s1, c1), (s2, c2) = fresnel(low_m * scale), fresnel(high_m * scale)
    return (c2 - c1 - 1j * (s2 - s1)) / (1 - 1j)


@pytest.mark.parametrize("across_m", [0.1, 0.28, 0.6, 1.5])
@pytest.mark.parametrize("foot_m", [(0.0, 0.0), (0.1, -0.2), (0.3, 0.0), (0.9, 0.4)])
def test_a_plate_of_any_size_is_the_product_of_two_fresnel_integrals(across_m, foot_m, wide):
    range_m = 50.0
    plate = rectangle(across_m, 0.8 * across_m)
    pulses = make_pulses(1, position_m=(*foot_m, range_m))
    (x, y), half = foot_m, across_m / 2
    expected = fresnel_between(-half - x, half - x, range_m) * fresnel_between(-0.8 * half - y, 0.8 * half - y, range_m)
    assert echo_of(plate, wide, make_chirp(), pulses, range_m) == pytest.approx(expected, abs=0.01)


def test_on_the_edge_of_a_big_plate_half_the_field_is_left(wide):
    plate = rectangle(12.0, 12.0)
    for x, share in ((6.0, 0.5), (0.0, 1.0)):
        level = abs(echo_of(plate, wide, make_chirp(), make_pulses(1, position_m=(x, 0.0, 50.0)), 50.0))
        assert level == pytest.approx(share, abs=0.01)


@pytest.mark.parametrize("zones", [0.2, 0.5, 1.0, 1.5, 2.0, 3.0, 5.0])
def test_a_disc_passes_its_fresnel_zones(zones, wide):
    """On the axis of a disc of n zones the field is 2 sin(pi n / 2) of the endless plane's."""
    range_m = 50.0
    # So many zones: (r - h) = n lambda / 4 for the way there, a half-wave for the way there and back.
    radius = np.sqrt((range_m + zones * WAVELENGTH_M / 4) ** 2 - range_m**2)
    angle = np.linspace(0, 2 * np.pi, 201)[:-1]
    corners = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle])
    faces = np.column_stack([np.full(200, 200), np.arange(200), np.roll(np.arange(200), -1)])
    disc = Surface(name="disc", vertices_m=np.vstack([corners, np.zeros(3)]), faces=faces, material="ground")
    level = abs(echo_of(disc, wide, make_chirp(), make_pulses(1, position_m=(0.0, 0.0, range_m)), range_m))
    assert level == pytest.approx(2 * abs(np.sin(np.pi * zones / 2)), abs=0.02)


@pytest.mark.parametrize("tilt_deg", [0.0, 0.4, 1.0, 1.9])
def test_a_small_plate_has_the_cross_section_of_the_textbook(tilt_deg, wide):
    """sigma = 4 pi A^2 / lambda^2 sinc^2(k a sin t), in the far field."""
    side, range_m = 0.1, 100.0
    plate = rectangle(side, side)
    turn = trimesh.transformations.rotation_matrix(np.deg2rad(tilt_deg), [0, 1, 0])[:3, :3]
    tilted = replace(plate, vertices_m=plate.vertices_m @ turn.T)
    paths = mirrors(scene_with(tilted), wide, make_chirp()).trace(make_pulses(1, position_m=(0.0, 0.0, range_m)))
    lobe = np.sinc(2 * side / WAVELENGTH_M * np.sin(np.deg2rad(tilt_deg)))
    sigma = 4 * np.pi * side**4 / WAVELENGTH_M**2 * lobe**2
    expected = wide.peak_gain**2 * WAVELENGTH_M**2 * sigma / ((4 * np.pi) ** 3 * range_m**4)
    measured = abs(coherent_sum(paths)) ** 2
    # The lobes of a plate an eleventh of a Fresnel zone wide lie a little off those of the far field.
    peak = expected / max(lobe**2, 1e-12)
    assert measured / peak == pytest.approx(lobe**2, abs=0.01)


def test_a_sphere_of_facets_has_the_cross_section_of_its_shadow():
    """sigma = pi a^2 of a metal sphere large against the wavelength: many facets in its one bright Fresnel zone.

    The beam fades toward the edge of the piece of the sphere, which would shine otherwise.
    """
    radius, range_m = 1.0, 60.0
    wide = make_antenna(0.5, 0.5)
    ball = surface_over(lambda x, y: np.sqrt(radius**2 - x**2 - y**2) - radius, 1.0, 0.02)
    paths = mirrors(scene_with(ball), wide, make_chirp()).trace(make_pulses(1, position_m=(0.0, 0.0, range_m)))
    sigma = np.pi * radius**2
    expected = wide.peak_gain**2 * WAVELENGTH_M**2 * sigma / ((4 * np.pi) ** 3 * range_m**4)
    # The facets, half the radius of the sphere's first zone long, cost 0.86 dB by direct quadrature over each of them.
    assert 10 * np.log10(abs(coherent_sum(paths)) ** 2 / expected) == pytest.approx(-0.86, abs=0.1)


def test_a_bowl_of_facets_focuses(wide):
    """Geometrical optics: 1 / (1 - h / R) of the plane's field, R the radius of curvature."""
    bowl = surface_over(lambda x, y: 1e-3 * (x**2 + y**2), 6.0, 0.125)
    level = abs(echo_of(bowl, wide, make_chirp(), make_pulses(1), 50.0))
    assert level == pytest.approx(1 / (1 - 50 / 500), rel=0.05)


def test_no_mirror_behind_a_plate_or_far_beside_it(wide):
    plate = mirrors(scene_with(rectangle(20.0, 20.0)), wide, make_chirp())
    for position in ((13.0, 0.0, 50.0), (9.9, 0.0, -50.0), (0.0, 0.0, -50.0)):
        assert len(plate.trace(make_pulses(1, position_m=position))) == 0


def test_what_stands_before_the_mirror_hides_it(pencil):
    plate = make_surface(lambda x, y: 0 * x, size_m=20.0)
    lid = make_surface(lambda x, y: 0 * x + 5, size_m=4.0, name="lid")
    paths = mirrors(scene_with(plate, lid), pencil, make_chirp()).trace(make_pulses(1))
    np.testing.assert_array_equal(paths.surface, [1])
    assert paths.hit_m[0, 2] == pytest.approx(5.0)


def test_a_tilted_wall_answers_only_across_its_plane():
    box = trimesh.creation.box(extents=(6.0, 6.0, 6.0))
    turn = trimesh.transformations.rotation_matrix(np.deg2rad(35), [1, 0, 0])
    box.apply_transform(turn)
    cube = Surface(name="cube", vertices_m=np.asarray(box.vertices), faces=np.asarray(box.faces), material="ground")
    normal = turn[:3, :3] @ [0, 0, 1]
    assert normal[1] < 0  # the top leans south, so that a radar in the south looks into it
    position = 60 * normal
    tracer = mirrors(scene_with(cube), make_antenna(2.0, 2.0), make_chirp())
    pulses = make_pulses(1, incidence_deg=35.0, position_m=tuple(position))
    paths = tracer.trace(pulses)
    assert len(paths) == 1
    np.testing.assert_allclose(paths.hit_m[0], 3 * normal, atol=1e-6)


def test_only_the_co_polar_receiver_sees_mirrors_and_only_if_asked(pencil):
    plate = make_surface(lambda x, y: 0 * x, size_m=200.0)
    dull = replace(shiny(), mirror=None)
    counts = []
    for material, antenna in ((shiny(), pencil), (dull, pencil), (shiny(), replace(pencil, receives="cross"))):
        scene = scene_with(plate, material=material)
        engine = BeamEngine(scene, antenna, make_chirp(), 1, 64, 0.05)
        tracer = Tracer(engine, scene, antenna, make_chirp(), RayCaster(scene.surfaces))
        pulses = make_pulses(4)
        counts.append(len(tracer.trace(pulses)) - len(engine.trace(pulses)))
    assert counts == [4, 0, 0]


def test_faces_without_an_area_are_no_mirrors():
    corner = np.array([[0.0, 0.0, 0.0], [1e-15, 0.0, 0.0], [0.0, 1e-15, 0.0]])
    speck = Surface(name="speck", vertices_m=corner, faces=np.array([[0, 1, 2]]), material="metal")
    assert patches_of(speck, 0, 0.008) == []
