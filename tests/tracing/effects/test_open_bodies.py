"""Open bodies: both sides of a sheet, and what of an inside is seen, against closed forms of physical optics."""

import numpy as np
import pytest
import trimesh
from scipy.constants import speed_of_light
from scipy.special import fresnel

from sionna_radar.scenario.objects import TargetMesh
from sionna_radar.tracing.build import rcs_of_mesh


def rcs_dbsm(path, mesh, carrier_hz, polar_deg, range_m):
    """Return the cross-section of a mesh from directions in its plane of forward and up, from its top on."""
    mesh.export(path)
    seen = TargetMesh(path=str(path))
    polar = np.deg2rad(np.atleast_1d(polar_deg))
    found = [rcs_of_mesh(seen, carrier_hz, np.zeros(1), np.array([np.pi / 2 - p]), range_m)[0, 0] for p in polar]
    return 10 * np.log10(found)


def sheet(*corners_m):
    """Two triangles of a rectangle."""
    return trimesh.Trimesh(np.array(corners_m, dtype=float), [[0, 1, 2], [0, 2, 3]], process=False)


def rectangle(right_m, forward_m, up_m=0.0):
    x, y = right_m / 2, forward_m / 2
    return sheet([-x, -y, up_m], [x, -y, up_m], [x, y, up_m], [-x, y, up_m])


def open_box(right_m, forward_m, up_m):
    """A floor at height zero and four walls, without a lid."""
    x, y, z = right_m / 2, forward_m / 2, up_m
    corner = np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]])
    top = corner + np.array([0.0, 0.0, z])
    walls = [sheet(corner[i], corner[(i + 1) % 4], top[(i + 1) % 4], top[i]) for i in range(4)]
    return trimesh.util.concatenate([rectangle(right_m, forward_m), *walls])


def pipe(radius_m, length_m, sections, rings):
    """An open pipe along the axis to the right."""
    angle = np.linspace(0, 2 * np.pi, sections, endpoint=False)
    place = np.linspace(-length_m / 2, length_m / 2, rings + 1)
    vertices = [[x, radius_m * np.cos(a), radius_m * np.sin(a)] for x in place for a in angle]
    ring, step = np.meshgrid(np.arange(rings), np.arange(sections), indexing="ij")
    a, b = (ring * sections + step).ravel(), (ring * sections + (step + 1) % sections).ravel()
    faces = np.vstack([np.column_stack([a, b, b + sections]), np.column_stack([a, b + sections, a + sections])])
    return trimesh.Trimesh(vertices, faces, process=False)


@pytest.mark.parametrize("range_m", [40.0, 3000.0])
def test_a_plate_is_the_same_from_both_sides(tmp_path, range_m):
    """4 pi A^2 / lambda^2 cos^2 sinc^2(k a sin)."""
    wavelength_m, polar = speed_of_light / 24e9, np.array([0.0, 1.5, 14.0])
    found = rcs_dbsm(tmp_path / "plate.ply", rectangle(0.14, 0.09), 24e9, [*polar, *(180 - polar)], range_m)
    phase = 2 * 0.09 / wavelength_m * np.sin(np.deg2rad(polar))
    expected = 4 * np.pi * (0.14 * 0.09 / wavelength_m * np.cos(np.deg2rad(polar)) * np.sinc(phase)) ** 2
    np.testing.assert_allclose(found, np.tile(10 * np.log10(expected), 2), atol=0.1)


@pytest.mark.parametrize(
    ("radius_m", "length_m", "carrier_hz", "range_m"), [(0.03, 0.4, 77e9, 60.0), (0.05, 0.25, 24e9, 2500.0)]
)
def test_an_open_pipe_is_a_cylinder_from_the_side(tmp_path, radius_m, length_m, carrier_hz, range_m):
    """2 pi a L^2 / lambda, with the Fresnel integrals of the waves' curvature along it; its far half is hidden."""
    wavelength_m = speed_of_light / carrier_hz
    found = rcs_dbsm(tmp_path / "pipe.ply", pipe(radius_m, length_m, 256, 8), carrier_hz, 90.0, range_m)
    end = length_m / np.sqrt(wavelength_m * range_m)
    curved = abs(np.dot(fresnel(end), [1j, 1.0]) / end) ** 2
    expected = 2 * np.pi * radius_m * length_m**2 / wavelength_m * curved
    assert found[0] == pytest.approx(10 * np.log10(expected), abs=0.2)


@pytest.mark.parametrize(("carrier_hz", "range_m"), [(77e9, 1500.0), (10e9, 300.0)])
def test_an_open_box_from_its_lid_its_back_and_its_sides(tmp_path, carrier_hz, range_m):
    """Its floor from both sides, and one wall: the far wall is hidden, however far away the radar is."""
    wavelength_m, right_m, forward_m, up_m = speed_of_light / carrier_hz, 0.11, 0.2, 0.07
    found = rcs_dbsm(tmp_path / "box.ply", open_box(right_m, forward_m, up_m), carrier_hz, [0.0, 90.0, 180.0], range_m)
    area_m2 = np.array([right_m * forward_m, right_m * up_m, right_m * forward_m])
    np.testing.assert_allclose(found, 10 * np.log10(4 * np.pi * (area_m2 / wavelength_m) ** 2), atol=0.4)


def test_the_corner_within_an_open_box_answers_through_its_lid(tmp_path):
    """Floor and far wall are a dihedral as high as the wall, while the near wall's shadow leaves both lit."""
    wavelength_m, polar = speed_of_light / 77e9, np.array([22.0, 37.0])
    found = rcs_dbsm(tmp_path / "box.ply", open_box(0.09, 0.2, 0.1), 77e9, polar, 1000.0)
    width_m = 2 * 0.1 * np.sin(np.deg2rad(polar))
    np.testing.assert_allclose(found, 10 * np.log10(4 * np.pi * (0.09 * width_m / wavelength_m) ** 2), atol=0.7)


@pytest.mark.parametrize("opening_m", [0.03, 0.055, 0.08])
def test_a_floor_is_seen_as_far_as_the_hole_above_it(tmp_path, opening_m):
    """A floor under a sheet with a slot: only the strip under the slot returns, and the sheet beside it."""
    wavelength_m, side_m, up_m = speed_of_light / 77e9, 0.2, 0.08
    beside_m = (side_m - opening_m) / 2
    parts = [rectangle(side_m, side_m)]
    for sign in (-1, 1):
        lid = rectangle(side_m, beside_m, up_m)
        lid.apply_translation([0.0, sign * (opening_m + beside_m) / 2, 0.0])
        parts.append(lid)
    found = rcs_dbsm(tmp_path / "slot.ply", trimesh.util.concatenate(parts), 77e9, 0.0, 20_000.0)
    turn = np.exp(4j * np.pi / wavelength_m * up_m)
    field_m2 = side_m * abs((side_m - opening_m) * turn + opening_m)
    assert found[0] == pytest.approx(10 * np.log10(4 * np.pi * (field_m2 / wavelength_m) ** 2), abs=0.3)
