"""Bodies that see themselves: corner reflectors against their closed forms, and what must not bounce."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from beams import make_chirp
from sionna_radar.scenario import parse_scenario
from sionna_radar.scenario.objects import TargetMesh
from sionna_radar.scene.model import Body
from sionna_radar.survey.preparation import prepare
from sionna_radar.tracing.build import rcs_of_mesh
from sionna_radar.tracing.effects.bodies import rcs_m2
from sionna_radar.tracing.effects.bouncing_rays import bounced_echoes
from sionna_radar.tracing.effects.physical_optics import Scatterer
from sionna_radar.tracing.effects.targets import trace_targets

CHIRP = make_chirp()
WAVELENGTH_M = CHIRP.wavelength_m


def scatterer(triangles, two_sided=True, reflectivity=1.0):
    corner = np.array(triangles, dtype=float).reshape(-1, 3)
    vertices, faces = trimesh.remesh.subdivide_to_size(corner, np.arange(len(corner)).reshape(-1, 3), 0.09)
    sheet = np.full(len(faces), two_sided)
    return Scatterer(Body(vertices_m=vertices, faces=faces, two_sided=sheet, reflectivity=reflectivity), WAVELENGTH_M)


def trihedral(side_m):
    """Three right triangles that meet at the origin, along the axes."""
    x, y, z = side_m * np.eye(3)
    return [[0 * x, x, y], [0 * x, y, z], [0 * x, z, x]]


def dihedral(level_m, upright_m, length_m, roll_deg=0.0):
    """Two rectangles that meet along x, one along y, one along z, rolled about the way to y = z."""
    x, y, z = length_m / 2 * np.eye(3)[0], level_m * np.eye(3)[1], upright_m * np.eye(3)[2]
    faces = [[-x, x, x + y], [-x, x + y, y - x], [-x, x + z, x], [-x, z - x, x + z]]
    roll = Rotation.from_rotvec(np.deg2rad(roll_deg) * np.array([0.0, 1.0, 1.0]) / np.sqrt(2))
    return [[roll.apply(corner) for corner in face] for face in faces]


def trihedral_rcs_m2(side_m, toward):
    """4 pi A^2 / lambda^2 of the part that sends back by three reflections, by the direction cosines, sorted."""
    one, two, three = np.sort(toward)
    total = one + two + three
    share = total - 2 / total if one + two >= three else 4 * one * two / total
    return 4 * np.pi * (side_m**2 * share) ** 2 / WAVELENGTH_M**2


@pytest.mark.parametrize("side_m", [0.12, 0.3])
def test_a_trihedral_is_that_of_books_from_all_around(side_m):
    """Knott, Shaeffer and Tuley, "Radar Cross Section"; from 20 deg off its axis on its plates alone add to it."""
    toward = np.array([[1, 1, 1], [1, 1.2, 0.9], [0.7, 1, 1.1], [1, 0.6, 0.5], [0.5, 1, 0.35]])
    toward = toward / np.linalg.norm(toward, axis=1)[:, None]
    found = rcs_m2(scatterer(trihedral(side_m)), toward, 500.0)
    expected = [trihedral_rcs_m2(side_m, one) for one in toward]
    np.testing.assert_allclose(10 * np.log10(found / expected), 0.0, atol=0.4)


@pytest.mark.parametrize(("level_m", "upright_m"), [(0.15, 0.15), (0.08, 0.2)])
def test_a_dihedral_is_that_of_books_across_its_edge(level_m, upright_m):
    """A plate that looks at the radar, as wide as both strips that meet both faces: 2 min(a sin p, b cos p)."""
    angle = np.deg2rad([20.0, 33.0, 45.0, 58.0, 71.0])
    toward = np.column_stack([0 * angle, np.cos(angle), np.sin(angle)])
    found = rcs_m2(scatterer(dihedral(level_m, upright_m, 0.1)), toward, 2000.0)
    width_m = 2 * np.minimum(level_m * np.sin(angle), upright_m * np.cos(angle))
    expected = 4 * np.pi * (0.1 * width_m / WAVELENGTH_M) ** 2
    np.testing.assert_allclose(10 * np.log10(found / expected), 0.0, atol=0.5)


@pytest.mark.parametrize(("roll_deg", "kept"), [(0.0, 1.0), (22.5, 0.5), (45.0, 0.0), (90.0, 1.0)])
def test_a_rolled_dihedral_turns_the_polarization(roll_deg, kept):
    toward, level = np.array([[0.0, 1.0, 1.0]]) / np.sqrt(2), np.array([[1.0, 0.0, 0.0]])
    upright = np.cross(toward, level)
    body, range_m = scatterer(dihedral(0.12, 0.12, 0.12, roll_deg)), 2000.0
    for received, share in ((level, kept), (upright, 1 - kept)):
        echoes = bounced_echoes(body, range_m * toward, level, received)
        phase = np.exp(-4j * np.pi / WAVELENGTH_M * (echoes.range_m - range_m))
        whole = 8 * np.pi * 0.12**4 / WAVELENGTH_M**2
        assert abs(np.sum(echoes.amplitude * phase)) ** 2 / whole == pytest.approx(share, abs=0.06)


def test_other_places_change_no_bit_of_one():
    rng, body = np.random.default_rng(4), scatterer(trihedral(0.1))
    place = 60.0 * (np.full(3, 3**-0.5) + 0.1 * rng.normal(size=(7, 3)))
    across = np.cross(place, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across, axis=1)[:, None]
    circular = (across + 1j * np.cross(place, across) / 60.0) / np.sqrt(2)
    for field in (across, circular):
        together = bounced_echoes(body, place, field, field)
        for row in range(len(place)):
            alone = bounced_echoes(body, place[[row]], field[[row]], field[[row]])
            own = together.row == row
            np.testing.assert_array_equal(alone.amplitude, together.amplitude[own])
            np.testing.assert_array_equal(alone.range_m, together.range_m[own])


def test_each_reflection_takes_its_share():
    toward = np.array([[1.0, 1.0, 1.0]]) / np.sqrt(3)
    metal, other = (rcs_m2(scatterer(trihedral(0.15), reflectivity=r), toward, 500.0) for r in (1.0, 0.5))
    assert other[0] / metal[0] == pytest.approx(0.5**3, rel=0.1)


def test_what_stands_before_a_corner_hides_it():
    screen = np.array([[0.35, 0.0, 0.0], [0.0, 0.35, 0.0], [0.0, 0.0, 0.35]]) * 1.2
    body = scatterer([*trihedral(0.1), screen])
    field = np.array([[1.0, -1.0, 0.0]]) / np.sqrt(2)
    assert len(bounced_echoes(body, np.full((1, 3), 100.0), field, field)) == 0
    assert len(bounced_echoes(scatterer(trihedral(0.1)), np.full((1, 3), 100.0), field, field)) > 0


def test_convex_bodies_and_sheets_do_not_see_themselves():
    for mesh in (trimesh.creation.box((0.1, 0.2, 0.3)), trimesh.creation.icosphere(radius=0.1)):
        assert not scatterer(mesh.triangles, two_sided=False).sees_itself
    assert not scatterer([[[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]]]).sees_itself
    ring = trimesh.creation.annulus(r_min=0.1, r_max=0.2, height=0.1)
    assert scatterer(ring.triangles, two_sided=False).sees_itself
    assert scatterer(trihedral(0.1)).sees_itself


def test_a_corner_reflector_of_a_file_echoes_as_its_cross_section_at_its_apex(tmp_path):
    """Looked at from 50 m straight above, its axis turned up: power, and range."""
    turn = Rotation.align_vectors([[0, 0, 1.0]], [[1.0, 1.0, 1.0]])[0]
    corner = turn.apply(np.array(trihedral(0.2)).reshape(-1, 3))
    path = tmp_path / "corner.ply"
    trimesh.Trimesh(corner, np.arange(9).reshape(-1, 3), process=False).export(path)
    book = 4 * np.pi * 0.2**4 / (3 * WAVELENGTH_M**2)
    found = rcs_of_mesh(TargetMesh(path=str(path)), CHIRP.carrier_hz, np.zeros(1), np.array([np.pi / 2]), 500.0)
    assert 10 * np.log10(found[0, 0] / book) == pytest.approx(0.0, abs=0.4)
    echoes = {}
    for name, what in {"mesh": {"mesh": {"path": str(path)}}, "point": {"rcs_dbsm": 10 * np.log10(book)}}.items():
        prepared = prepare(
            parse_scenario(
                {
                    "terrain": {"kind": "flat", "size_m": [200.0, 200.0]},
                    "platform": {"altitude_m": 50.0, "speed_mps": 5.0, "length_m": 10.0},
                    "radar": {"snr_db": 30.0, "scan": {"mode": "fixed", "incidence_deg": 0.0}},
                    "targets": [{"position_m": [5.0, 0.0], "height_m": 0.3, **what}],
                }
            )
        )
        count = len(prepared)
        block, scene = prepared.flight.pulses(np.array([count // 2 - 3, count // 2])), prepared.world.scene
        given = (block, prepared.instrument.antenna, prepared.receiver.chirp, prepared.world.caster, 1)
        paths = trace_targets(scene.targets, *given)
        row, carrier_hz = block.row_of(paths.pulse), prepared.receiver.chirp.carrier_hz
        field = paths.gain * np.exp(-2j * np.pi * carrier_hz * paths.delay_s)
        total, weight = np.bincount(row, field.real) + 1j * np.bincount(row, field.imag), np.abs(paths.gain) ** 2
        echoes[name] = np.abs(total) ** 2, np.bincount(row, weight * paths.delay_s) / np.bincount(row, weight), total
    np.testing.assert_allclose(10 * np.log10(echoes["mesh"][0] / echoes["point"][0]), 0.0, atol=0.6)
    # Faces in an eighth of a range cell are one path.
    np.testing.assert_allclose(echoes["mesh"][1], echoes["point"][1], atol=2 / 299_792_458.0 * 0.02)
    turn = np.angle(echoes["mesh"][2] / echoes["point"][2])
    assert np.angle(np.exp(1j * np.diff(turn))) == pytest.approx(0.0, abs=0.1)
