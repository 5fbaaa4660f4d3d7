"""Mirror reflections against the image of the radar."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from sionna_radar.scene.backscatter import ConstantGammaBackscatter
from sionna_radar.scene.model import Scene, Surface
from sionna_radar.scene.permittivity import building_permittivity
from sionna_radar.scene.radar_material import Mirror, RadarMaterial
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.scene.rough_surface import fresnel_reflection
from sionna_radar.tracing.beam_solver import BeamEngine
from sionna_radar.tracing.engine import Tracer
from sionna_radar.tracing.mirrors import MirrorTracer

C = 299_792_458.0
WAVELENGTH_M = C / 77e9
METAL = building_permittivity("metal", 77e9)


def shiny(permittivity=METAL, rms_height_m=0.0) -> RadarMaterial:
    dull = ConstantGammaBackscatter(1e-3)
    mirror = Mirror(permittivity=permittivity, rms_height_m=rms_height_m, frequency_hz=77e9)
    return RadarMaterial(vertical=dull, horizontal=dull, mirror=mirror)


def scene_with(*surfaces, material=None) -> Scene:
    return Scene(
        surfaces=surfaces,
        materials={"ground": material or shiny()},
        targets=(),
        ground_material="ground",
        georeference=None,
    )


def mirrors(scene, antenna, chirp) -> MirrorTracer:
    return MirrorTracer(scene, antenna, chirp, RayCaster(scene.surfaces))


@pytest.mark.parametrize("polarization", ["V", "H"])
@pytest.mark.parametrize("height_m", [10.0, 50.0, 120.0])
def test_a_big_metal_plate_is_the_radars_image(surface_of, antenna_of, chirp_of, looking, height_m, polarization):
    antenna = antenna_of(2.0, 2.0, polarization)
    plate = scene_with(surface_of(lambda x, y: 0 * x, size_m=20.0))
    velocity = (1.0, 2.0, -3.0)
    paths = mirrors(plate, antenna, chirp_of()).trace(
        looking(3, position_m=(1.0, 2.0, height_m), velocity_mps=velocity, first=5)
    )
    np.testing.assert_array_equal(paths.pulse, [5, 6, 7])
    friis = (antenna.peak_gain * WAVELENGTH_M / (4 * np.pi * 2 * height_m)) ** 2
    assert 10 * np.log10(np.abs(paths.gain[0]) ** 2 / friis) == pytest.approx(0.0, abs=0.01)
    np.testing.assert_allclose(paths.hit_m, np.tile([1.0, 2.0, 0.0], (3, 1)), atol=1e-9)
    np.testing.assert_allclose(paths.delay_s, 2 * height_m / C, rtol=1e-12)
    np.testing.assert_allclose(paths.range_rate_mps, -3.0)
    np.testing.assert_array_equal(paths.incidence_rad, 0.0)


def test_doubling_the_range_to_a_mirror_costs_6_db(surface_of, pencil, chirp_of, looking):
    plate = mirrors(scene_with(surface_of(lambda x, y: 0 * x, size_m=20.0)), pencil, chirp_of())
    near, far = (abs(plate.trace(looking(1, position_m=(0.0, 0.0, h))).gain[0]) for h in (20.0, 40.0))
    assert 20 * np.log10(near / far) == pytest.approx(20 * np.log10(2), abs=1e-9)


def test_roughness_and_medium_weaken_it(surface_of, pencil, chirp_of, looking):
    plate = surface_of(lambda x, y: 0 * x, size_m=20.0)
    glass = building_permittivity("glass", 77e9)
    levels = [
        20 * np.log10(abs(mirrors(scene_with(plate, material=m), pencil, chirp_of()).trace(looking(1)).gain[0]))
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


def test_no_mirror_beside_the_plate_or_behind_it_or_in_a_small_one(surface_of, pencil, chirp_of, looking):
    plate = mirrors(scene_with(surface_of(lambda x, y: 0 * x, size_m=20.0)), pencil, chirp_of())
    for position in ((10.2, 0.0, 50.0), (9.9, 0.0, 50.0), (0.0, 0.0, -50.0)):
        assert len(plate.trace(looking(1, position_m=position))) == 0
    assert len(plate.trace(looking(1, position_m=(9.6, 0.0, 50.0)))) == 1
    # The first Fresnel zone is 0.31 m in radius at 50 m, 0.2 m at 20 m.
    small = mirrors(scene_with(surface_of(lambda x, y: 0 * x, size_m=0.5, spacing_m=0.25)), pencil, chirp_of())
    assert len(small.trace(looking(1, position_m=(0.0, 0.0, 50.0)))) == 0
    assert len(small.trace(looking(1, position_m=(0.0, 0.0, 20.0)))) == 1


def test_what_stands_before_the_mirror_hides_it(surface_of, pencil, chirp_of, looking):
    plate = surface_of(lambda x, y: 0 * x, size_m=20.0)
    lid = surface_of(lambda x, y: 0 * x + 5, size_m=4.0, name="lid")
    paths = mirrors(scene_with(plate, lid), pencil, chirp_of()).trace(looking(1))
    np.testing.assert_array_equal(paths.surface, [1])
    assert paths.hit_m[0, 2] == pytest.approx(5.0)


def test_a_tilted_wall_answers_only_across_its_plane(antenna_of, chirp_of, looking):
    box = trimesh.creation.box(extents=(6.0, 6.0, 6.0))
    turn = trimesh.transformations.rotation_matrix(np.deg2rad(35), [1, 0, 0])
    box.apply_transform(turn)
    cube = Surface(name="cube", vertices_m=np.asarray(box.vertices), faces=np.asarray(box.faces), material="ground")
    normal = turn[:3, :3] @ [0, 0, 1]
    assert normal[1] < 0  # the top leans south, so that a radar in the south looks into it
    position = 60 * normal
    tracer = mirrors(scene_with(cube), antenna_of(2.0, 2.0), chirp_of())
    pulses = looking(1, incidence_deg=35.0, position_m=tuple(position))
    paths = tracer.trace(pulses)
    assert len(paths) == 1
    np.testing.assert_allclose(paths.hit_m[0], 3 * normal, atol=1e-6)


def test_curved_ground_has_no_mirror(surface_of, pencil, chirp_of, looking):
    bowl = scene_with(surface_of(lambda x, y: 1e-3 * (x**2 + y**2), size_m=20.0, spacing_m=0.25))
    assert len(mirrors(bowl, pencil, chirp_of()).trace(looking(5))) == 0


def test_only_the_co_polar_receiver_sees_mirrors_and_only_if_asked(surface_of, pencil, chirp_of, looking):
    plate = surface_of(lambda x, y: 0 * x, size_m=200.0)
    dull = replace(shiny(), mirror=None)
    counts = []
    for material, antenna in ((shiny(), pencil), (dull, pencil), (shiny(), replace(pencil, receives="cross"))):
        scene = scene_with(plate, material=material)
        engine = BeamEngine(scene, antenna, chirp_of(), 1, 64, 0.05)
        tracer = Tracer(engine, scene, antenna, chirp_of(), RayCaster(scene.surfaces))
        pulses = looking(4)
        counts.append(len(tracer.trace(pulses)) - len(engine.trace(pulses)))
    assert counts == [4, 0, 0]
