"""The facet engine against the radar equation, its shadows, and the phases of facets that stay."""

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.constants import speed_of_light
from scipy.stats import kstest

from beams import make_chirp, plane_power
from flights import make_pulses
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.randomness import split_mix
from sionna_radar.radar.equation import plane_echo
from sionna_radar.scene.model import Surface
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.surfaces.backscatter import ConstantGammaBackscatter, LambertianBackscatter
from sionna_radar.tracing.engines.gamma import facets
from sionna_radar.tracing.engines.gamma.facet_index import MIN_ROOM, FacetIndex, Fineness, Footprint
from sionna_radar.tracing.engines.gamma.facet_mesh import Facets, facets_of
from sionna_radar.tracing.engines.gamma.facets import GammaEngine
from worlds import make_scene, make_surface

WAVELENGTH_M = speed_of_light / 77e9


def pulse_power(paths, count=1):
    return np.bincount(paths.pulse, np.abs(paths.gain) ** 2, minlength=count)


def db(ratio):
    return 10 * np.log10(ratio)


def triangle(corners, name="facet"):
    return Surface(name=name, vertices_m=np.array(corners, dtype=float), faces=np.array([[0, 1, 2]]), material="ground")


def engine_over(scene, antenna, chirp, **options):
    return GammaEngine(scene, antenna, chirp, 1, RayCaster(scene.surfaces), **options)


@pytest.fixture(scope="module")
def over_plane(plane, pencil):
    return engine_over(plane, pencil, make_chirp())


@pytest.fixture(scope="module")
def rough():
    """Hills of half-metre triangles."""
    return make_scene(
        make_surface(lambda x, y: 2 * np.sin(x / 9) * np.cos(y / 7), size_m=120.0, spacing_m=0.5, centre_m=(0, 50))
    )


def test_the_file_imports_nothing_of_sionna_mitsuba_or_drjit():
    tree = ast.parse(Path(facets.__file__).read_text())
    imported = [n.module or "" for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)]
    imported += [alias.name for n in ast.walk(tree) if isinstance(n, ast.Import) for alias in n.names]
    assert not {name.split(".")[0] for name in imported} & {"sionna", "mitsuba", "drjit"}


@pytest.mark.parametrize("incidence_deg", [0, 20, 45, 60, 75])
def test_power_over_a_plane_is_that_of_the_integral(over_plane, pencil, incidence_deg):
    # Different places, so that the beam falls differently onto the facets.
    place = np.column_stack([np.linspace(-3, 3, 8), np.linspace(0, 2, 8), np.full(8, 50.0)])
    paths = over_plane.trace(make_pulses(8, incidence_deg=incidence_deg, position_m=place))
    expected = plane_power(pencil, 50.0, incidence_deg)
    np.testing.assert_allclose(db(pulse_power(paths, 8) / expected), 0.0, atol=0.05)
    assert abs(db(pulse_power(paths, 8).mean() / expected)) < 0.01


def test_any_model_of_backscatter_works(plane, pencil):
    lambertian = LambertianBackscatter(0.1)
    scene = make_scene(*plane.surfaces, materials={"ground": lambertian})
    paths = engine_over(scene, pencil, make_chirp()).trace(make_pulses(1, incidence_deg=50.0))
    expected = plane_echo(pencil, lambertian, WAVELENGTH_M, 50.0, np.deg2rad(50.0))
    assert db(pulse_power(paths)[0] / expected) == pytest.approx(0.0, abs=0.05)


@pytest.mark.parametrize("finer", [{"range_cells": 1.0}, {"beam_fraction": 0.2}])
def test_finer_facets_change_no_power(plane, pencil, over_plane, finer):
    pulses = make_pulses(4, incidence_deg=45.0, scan_deg=np.array([-20.0, 0.0, 7.0, 30.0]))
    coarse, fine = over_plane.trace(pulses), engine_over(plane, pencil, make_chirp(), **finer).trace(pulses)
    assert len(fine) > 1.5 * len(coarse)
    np.testing.assert_allclose(db(pulse_power(fine, 4) / pulse_power(coarse, 4)), 0.0, atol=0.02)


def test_two_huge_triangles_echo_like_a_fine_mesh(pencil):
    pulses = make_pulses(1, incidence_deg=55.0)
    powers = []
    for spacing in (400.0, 1.0):
        scene = make_scene(make_surface(lambda x, y: 0 * x, size_m=400.0, spacing_m=spacing))
        powers.append(pulse_power(engine_over(scene, pencil, make_chirp()).trace(pulses))[0])
    assert db(powers[0] / powers[1]) == pytest.approx(0.0, abs=0.02)


@pytest.mark.parametrize("incidence_deg", [0, 45, 70])
def test_the_footprint_loses_no_power_worth_telling(over_plane, plane, pencil, incidence_deg):
    pulses = make_pulses(1, incidence_deg=incidence_deg)
    wide = engine_over(plane, pencil, make_chirp(), footprint_db=-70.0).trace(pulses)
    lost = 1 - pulse_power(over_plane.trace(pulses))[0] / pulse_power(wide)[0]
    # 0.0005 dB of it; 20 dB brighter, the same directions would hold 0.05 dB.
    assert 0 <= lost < 1.2e-4


def test_a_ball_in_the_footprint_is_never_missed(pencil):
    footprint = Footprint.of(pencil, -50.0)
    rng = np.random.default_rng(0)
    centre = rng.normal(0, 1, (2000, 3)) * [30, 4, 4] + [20, 0, 0]
    radius = rng.uniform(0, 10, 2000)
    offset = rng.normal(0, 1, (2000, 3))
    inside = centre + offset / np.linalg.norm(offset, axis=1, keepdims=True) * radius[:, None] * 0.999
    held = footprint.meets(inside, 0.0)
    assert held.any()
    assert footprint.meets(centre, radius)[held].all()


def test_a_facet_behind_a_wall_gives_nothing(pencil):
    ground = make_surface(lambda x, y: 0 * x, size_m=300.0, spacing_m=2.0)
    # Across the beam 20 m ahead, 40 m high, facing the radar: it hides what lies beyond.
    corners = [[-50, 20, 0], [50, 20, 0], [50, 20, 40], [-50, 20, 40]]
    wall = Surface(
        name="wall",
        vertices_m=np.array(corners, float),
        faces=np.array([[0, 1, 2], [0, 2, 3]]),
        material="ground",
    )
    pulses = make_pulses(1, incidence_deg=45.0, position_m=(0.0, 0.0, 50.0))
    open_field = engine_over(make_scene(ground), pencil, make_chirp()).trace(pulses)
    walled = engine_over(make_scene(ground, wall), pencil, make_chirp()).trace(pulses)
    assert (open_field.hit_m[:, 1] > 30).any()
    assert not (walled.hit_m[:, 1] > 20.01).any()
    assert (walled.surface == 1).any()


def test_a_facet_that_faces_away_gives_nothing(pencil):
    corners = [[-0.1, -0.1, 0], [0.1, -0.1, 0], [0, 0.1, 0]]
    up, down = make_scene(triangle(corners)), make_scene(triangle(corners[::-1]))
    assert len(engine_over(up, pencil, make_chirp()).trace(make_pulses())) == 1
    nothing = engine_over(down, pencil, make_chirp()).trace(make_pulses(3))
    assert len(nothing) == 0
    assert nothing.hit_m.shape == (0, 3)


def test_one_facet_obeys_the_radar_equation(pencil):
    scene = make_scene(triangle([[-0.1, -0.1, 0], [0.1, -0.1, 0], [0, 0.1, 0]]), gamma=0.02)
    paths = engine_over(scene, pencil, make_chirp()).trace(make_pulses(velocity_mps=(0.0, 0.0, -3.0)))
    power = pencil.peak_gain**2 * WAVELENGTH_M**2 * 0.02 * 0.02 / ((4 * np.pi) ** 3 * 50.0**4)
    assert np.abs(paths.gain[0]) ** 2 == pytest.approx(power, rel=1e-3)
    assert paths.range_rate_mps[0] == pytest.approx(-3.0, rel=1e-5)
    assert paths.surface[0] == 0


def test_the_phase_of_a_fixed_facet_follows_its_range(pencil):
    scene = make_scene(triangle([[0.2, 0.1, 0.0], [0.5, 0.1, 0.02], [0.3, 0.4, 0.05]]))
    centre = scene.surfaces[0].vertices_m.mean(axis=0)
    place = np.column_stack([np.zeros(50), 0.03 * np.arange(50) - 0.6, np.full(50, 50.0)])
    paths = engine_over(scene, pencil, make_chirp()).trace(make_pulses(50, position_m=place))
    assert len(paths) == 50
    phase = np.angle(paths.gain * np.exp(-2j * np.pi * np.mod(77e9 * paths.delay_s, 1.0)))
    range_m = np.linalg.norm(centre - place, axis=1)
    expected = -4 * np.pi / WAVELENGTH_M * (range_m - range_m[0])
    error = np.angle(np.exp(1j * (phase - phase[0] - expected)))
    assert np.ptp(expected) > 10
    np.testing.assert_allclose(error, 0.0, atol=1e-6)


def test_phases_hang_on_the_seed_and_are_spread_evenly(rough, pencil):
    caster = RayCaster(rough.surfaces)
    pulses = make_pulses(20, incidence_deg=45.0, scan_deg=np.linspace(-30, 30, 20))
    one, other = (GammaEngine(rough, pencil, make_chirp(), seed, caster).trace(pulses) for seed in (1, 2**62))
    np.testing.assert_array_equal(one.hit_m, other.hit_m)
    place, first = np.unique(one.hit_m, axis=0, return_index=True)
    assert len(place) > 5000
    for paths in (one, other):
        assert kstest(np.angle(paths.gain[first]) / (2 * np.pi) + 0.5, "uniform").pvalue > 0.01
    assert abs(np.exp(1j * (np.angle(one.gain) - np.angle(other.gain)))[first].mean()) < 0.05


def test_too_many_facets_for_memory_are_taken_pulse_by_pulse_and_refused_in_one(plane, pencil, monkeypatch):
    """Over a mesh of 20 m all are divided, some thousands a pulse."""
    engine, pulses = engine_over(plane, pencil, make_chirp()), make_pulses(40, incidence_deg=30.0)
    whole = engine.trace(pulses)
    each = int(np.bincount(whole.pulse).max())
    monkeypatch.setattr(facets, "MAX_FACETS", 3 * each)
    few = engine.trace(pulses)
    np.testing.assert_array_equal(few.gain, whole.gain)
    np.testing.assert_array_equal(few.delay_s, whole.delay_s)
    monkeypatch.setattr(facets, "MAX_FACETS", each // 2)
    with pytest.raises(ScenarioError, match="divides the ground in one beam into more than"):
        engine.trace(pulses)


def test_the_block_size_changes_no_bit(rough, pencil, monkeypatch):
    engine = engine_over(rough, pencil, make_chirp())
    scan = np.linspace(-35, 35, 12)
    whole = engine.trace(make_pulses(12, incidence_deg=45.0, scan_deg=scan, first=5))
    monkeypatch.setattr(facets, "RAYS_AT_ONCE", 2000)
    waves = engine.trace(make_pulses(12, incidence_deg=45.0, scan_deg=scan, first=5))
    single = [
        engine.trace(make_pulses(1, incidence_deg=45.0, scan_deg=scan[i : i + 1], first=5 + i)) for i in range(12)
    ]
    assert np.all(np.diff(whole.pulse) >= 0)
    for name in ("pulse", "delay_s", "gain", "range_rate_mps", "incidence_rad", "hit_m", "surface"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(waves, name))
        np.testing.assert_array_equal(getattr(whole, name), np.concatenate([getattr(paths, name) for paths in single]))


def area_vector(facets: Facets) -> np.ndarray:
    a, b, c = np.moveaxis(facets.corner_m, 1, 0)
    return np.cross(b - a, c - a) / 2


@pytest.mark.parametrize("divide", [Facets.halved, *(lambda f, n=n: f.divided(n) for n in (2, 3, 4))])
def test_the_pieces_of_a_facet_cover_it_and_keep_its_side(divide):
    rng = np.random.default_rng(1)
    whole = facets_of([triangle(rng.normal(0, 5, (3, 3))) for _ in range(7)])
    pieces = divide(whole)
    assert len(set(pieces.identity.tolist()) | set(whole.identity.tolist())) == len(pieces) + len(whole)
    for surface in range(7):
        own = area_vector(pieces.rows(pieces.surface == surface))
        np.testing.assert_allclose(own.sum(axis=0), area_vector(whole)[surface], rtol=1e-9)
        np.testing.assert_allclose(own, np.broadcast_to(own[0], own.shape), rtol=1e-9)
        mean = pieces.centre_m[pieces.surface == surface].mean(axis=0)
        np.testing.assert_allclose(mean, whole.centre_m[surface], rtol=1e-9)


def test_the_identities_are_those_of_splitmix64():
    # The first numbers of splitmix64.c from the state 0, as published for many implementations of it.
    first = split_mix(np.zeros(1, dtype=np.uint64), np.array([1, 2, 3], dtype=np.uint64))
    assert [hex(int(x)) for x in first] == ["0xe220a8397b1dcdaf", "0x6e789e6aa1b965f4", "0x6c45d188009454f"]


def test_each_surface_scatters_with_its_own_material(pencil):
    near = make_surface(lambda x, y: 0 * x, size_m=200.0)
    halves = [
        replace(near, faces=near.faces[near.vertices_m[near.faces, 0].mean(axis=1) < 0], material="weak"),
        replace(near, faces=near.faces[near.vertices_m[near.faces, 0].mean(axis=1) > 0], material="strong"),
    ]
    materials = {"weak": ConstantGammaBackscatter(0.01), "strong": ConstantGammaBackscatter(0.1)}
    scene = make_scene(*halves, materials=materials)
    paths = engine_over(scene, pencil, make_chirp()).trace(make_pulses(1, incidence_deg=30.0))
    power = np.bincount(paths.surface, np.abs(paths.gain) ** 2)
    assert db(power[1] / power[0]) == pytest.approx(10.0, abs=0.05)


def test_the_search_finds_what_a_look_at_every_facet_does(rough, pencil):
    index, footprint = FacetIndex(facets_of(rough.surfaces)), Footprint.of(pencil, -50.0)
    fineness = Fineness(per_metre=0.012, longest_m=0.75)
    pose = make_pulses(40, incidence_deg=45.0, scan_deg=np.linspace(-30, 30, 40)).true
    row, place, coarse = index.search(footprint, fineness, pose, 3, 40)
    for pulse in range(3, 40):
        away = index.scatterers.place_m - pose.position_m[pulse]
        divided = fineness.subdivisions(index.side_m, np.linalg.norm(away, axis=1)) > 1
        met = footprint.meets(away @ pose.R_world_antenna[pulse], np.where(divided, index.radius_m, 0.0))
        np.testing.assert_array_equal(place[row == pulse], np.flatnonzero(met))
        np.testing.assert_array_equal(coarse[row == pulse], divided[met])
    # More than there is room for at first.
    assert len(place) > MIN_ROOM
