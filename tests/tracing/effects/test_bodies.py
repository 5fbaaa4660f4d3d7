"""Targets with a shape, by physical optics: closed forms, phase, and what hides what."""

import numpy as np
import pytest
import trimesh

from beams import make_chirp
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.scene.model import Body
from sionna_radar.survey.preparation import prepare
from sionna_radar.tracing.effects.bodies import rcs_m2
from sionna_radar.tracing.effects.physical_optics import Scatterer
from targets import over_target, target_paths

WAVELENGTH_M = make_chirp().wavelength_m


def scatterer(mesh, longest_m=0.05, two_sided=False):
    vertices, faces = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, longest_m)
    return Scatterer(Body(vertices_m=vertices, faces=faces, two_sided=np.full(len(faces), two_sided)), WAVELENGTH_M)


def directions(polar_deg):
    polar = np.deg2rad(np.atleast_1d(polar_deg))
    return np.column_stack([np.sin(polar), 0 * polar, np.cos(polar)])


def plate(side_m):
    half = side_m / 2
    corner = [[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]]
    return trimesh.Trimesh(corner, [[0, 1, 2], [0, 2, 3]])


def test_a_plate_is_that_of_physical_optics_from_all_sides():
    """4 pi A^2 / lambda^2 cos^2 sinc^2(k a sin), to all digits of a far field."""
    side_m, polar = 0.1, np.array([0.0, 0.4, 1.0, 3.3, 10.0, 41.0])
    found = rcs_m2(scatterer(plate(side_m)), directions(polar), 1e5)
    phase = 2 * side_m / WAVELENGTH_M * np.sin(np.deg2rad(polar))
    expected = 4 * np.pi * side_m**4 / WAVELENGTH_M**2 * (np.cos(np.deg2rad(polar)) * np.sinc(phase)) ** 2
    np.testing.assert_allclose(found, expected, rtol=1e-3)
    assert rcs_m2(scatterer(plate(side_m)), directions(180.0), 1e5) == 0.0  # from behind
    assert rcs_m2(scatterer(plate(side_m), two_sided=True), directions(180.0), 1e5) == pytest.approx(found[0])


def test_how_finely_a_plate_is_divided_does_not_matter():
    polar = np.array([0.3, 5.0, 60.0])
    coarse, fine = (rcs_m2(scatterer(plate(0.1), longest_m), directions(polar), 50.0) for longest_m in (0.08, 0.01))
    np.testing.assert_allclose(coarse, fine, rtol=2e-2)


def test_a_sphere_and_a_cylinder():
    """pi a^2, and 2 pi a L^2 / lambda from the side; facets follow the curve to a fraction of a wavelength."""
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.05)
    seen = np.random.default_rng(1).normal(size=(6, 3))
    seen /= np.linalg.norm(seen, axis=1)[:, None]
    found = rcs_m2(scatterer(ball), seen, 200.0)
    assert 10 * np.log10(found.mean() / (np.pi * 0.05**2)) == pytest.approx(0.0, abs=0.5)
    pipe = trimesh.creation.cylinder(radius=0.02, height=0.3, sections=512)
    found = rcs_m2(scatterer(pipe), directions(90.0), 1e4)
    assert 10 * np.log10(found[0] / (2 * np.pi * 0.02 * 0.3**2 / WAVELENGTH_M)) == pytest.approx(0.0, abs=0.5)


def test_what_stands_before_a_plate_hides_it():
    near = plate(0.3)
    near.apply_translation([0.0, 0.0, 1.0])
    both, one = scatterer(trimesh.util.concatenate([plate(0.1), near])), scatterer(near)
    place = np.array([[0.0, 0.0, 30.0]])
    assert np.count_nonzero(both.amplitude(place)) == np.count_nonzero(one.amplitude(place)) > 0


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    path = tmp_path_factory.mktemp("body") / "ball.ply"
    trimesh.creation.icosphere(subdivisions=5, radius=50.0).export(path)
    return {"path": str(path), "units": "mm"}


def test_a_ball_echoes_as_a_point_on_its_near_side(ball):
    """Its power is that of its cross-section, and its phase that of the range to its front, pulse by pulse."""
    where = {"position_m": [3.0, 1.0], "height_m": 2.0}
    block, body = target_paths(over_target(where | {"mesh": ball}), np.arange(0, 720, 40))
    _, point = target_paths(
        over_target(where | {"rcs_dbsm": 10 * np.log10(np.pi * 0.05**2), "swerling": 0}), block.index
    )
    chirp = make_chirp()
    row, field = block.row_of(body.pulse), body.gain * np.exp(-2j * np.pi * chirp.carrier_hz * body.delay_s)
    total = np.bincount(row, field.real) + 1j * np.bincount(row, field.imag)
    np.testing.assert_allclose(20 * np.log10(np.abs(total) / np.abs(point.gain)), 0.0, atol=0.8)
    # The front is a radius nearer; physical optics turns the echo of a front by a quarter.
    front = np.exp(-2j * np.pi * chirp.carrier_hz * (point.delay_s - 2 * 0.05 / 299_792_458.0))
    turn = total / np.abs(total) / front
    np.testing.assert_allclose(turn, turn.mean() / abs(turn.mean()), atol=0.2)


def test_a_body_moves_and_turns_with_its_way(ball):
    target = {"position_m": [-8.0, -3.0], "height_m": 1.0, "mesh": ball, "waypoints_m": [[8.0, 5.0]], "speed_mps": 12.0}
    block, paths = target_paths(over_target(target), np.arange(100, 104))
    first = [int(np.flatnonzero(paths.pulse == index)[0]) for index in block.index]
    centre = [np.average(paths.hit_m[paths.pulse == index], axis=0) for index in block.index]
    assert np.linalg.norm(np.diff(centre, axis=0), axis=1) / np.diff(block.time_s) == pytest.approx(
        [12.0] * 3, rel=0.05
    )
    range_m = np.linalg.norm(np.array(centre) - block.true.position_m, axis=1)
    slope = np.gradient(range_m, block.time_s)
    np.testing.assert_allclose(paths.range_rate_mps[first], slope, atol=0.6)


def test_a_mesh_neither_fluctuates_nor_has_a_cross_section(ball):
    for wrong in ({"swerling": 1}, {"rcs_dbsm": 0.0}):
        with pytest.raises(ScenarioError, match="mesh"):
            over_target({"position_m": [0.0, 0.0], "mesh": ball} | wrong)
    with pytest.raises(ScenarioError, match="faces"):
        prepare(over_target({"position_m": [0.0, 0.0], "mesh": ball | {"units": "m", "scale": 0.5}}))


def test_a_body_casts_a_shadow_that_goes_along_with_it(ball):
    """Ground behind a ball is not seen, as far as the cone of its outline reaches; the rest is as without it."""
    table = {"position_m": [0.0, 0.0], "height_m": 5.0, "mesh": ball | {"scale": 40.0}}
    plain, shaded = (prepare(over_target(t)) for t in ({"position_m": [0.0, 0.0], "rcs_dbsm": -90.0}, table))
    paths = []
    for prepared in (plain, shaded):
        block = prepared.flight.pulses(np.array([100, 700]))
        found = prepared.sensor_inputs().tracer().trace(block)
        paths.append(found.rows(found.surface >= 0))
    radar = block.true.position_m[block.row_of(paths[0].pulse)]
    away = paths[0].hit_m - radar
    toward = np.array([0.0, 0.0, 5.0]) - radar
    cosine = np.sum(away * toward, axis=1) / np.linalg.norm(away, axis=1) / np.linalg.norm(toward, axis=1)
    aside = np.arccos(cosine) / np.arcsin(2.0 / np.linalg.norm(toward, axis=1))
    known = set(map(tuple, np.column_stack([paths[1].pulse, paths[1].hit_m]).tolist()))
    kept = np.array([tuple(row) in known for row in np.column_stack([paths[0].pulse, paths[0].hit_m]).tolist()])
    assert not kept[aside < 0.99].any()
    assert kept[aside > 1.01].all()
    assert np.count_nonzero(aside < 0.99) > 5
