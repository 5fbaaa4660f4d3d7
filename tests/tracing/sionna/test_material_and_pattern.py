"""The contract with Sionna RT: our antenna, our material and our orientations as Sionna sees them."""

import numpy as np
import pytest

from beams import make_antenna, make_chirp
from flights import make_pulses
from sionna_radar.surfaces.backscatter import ConstantGammaBackscatter, LambertianBackscatter
from sionna_radar.tracing.sionna.material import dr, mi
from sionna_radar.tracing.sionna.pattern import SionnaPattern, sionna_angles
from sionna_radar.tracing.sionna.scene import SionnaScene
from worlds import make_scene, make_surface

from sionna.rt.utils import rotation_matrix  # isort: skip  (after the variant is chosen)


def directions(count: int, spread: float) -> np.ndarray:
    """Unit vectors about the x axis, up to backward ones."""
    away = np.random.default_rng(3).normal(size=(count, 3)) * [1, spread, spread] + [1, 0, 0]
    return away / np.linalg.norm(away, axis=1, keepdims=True)


@pytest.mark.parametrize("polarization", ["V", "H"])
@pytest.mark.parametrize("widths", [(2.0, 2.0), (6.0, 15.0)])
@pytest.mark.parametrize("spread", [0.03, 1.0])
def test_sionna_sees_the_same_gain(polarization, widths, spread):
    antenna = make_antenna(*widths, polarization)
    (pattern,) = SionnaPattern(antenna).patterns
    away = directions(4000, spread)
    theta, phi = np.arccos(away[:, 2]), np.arctan2(away[:, 1], away[:, 0])
    c_theta, c_phi = pattern(mi.Float(theta.astype(np.float32)), mi.Float(phi.astype(np.float32)))
    kept, other = (c_theta, c_phi) if polarization == "V" else (c_phi, c_theta)
    gain = (dr.squared_norm(kept)).numpy()
    # Angles in float32 shift a narrow beam by 1e-7 rad; near nulls only the distance to the peak counts.
    np.testing.assert_allclose(gain, antenna.gain(away), rtol=2e-3, atol=2e-6 * antenna.peak_gain)
    np.testing.assert_array_equal(dr.squared_norm(other).numpy(), 0.0)


def test_a_sionna_orientation_turns_like_our_matrix():
    for incidence_deg, scan_deg, heading_deg in [(0, 0, 0), (45, 30, 110), (70, -80, 250), (0, 0, 90)]:
        R = make_pulses(1, incidence_deg=incidence_deg, scan_deg=scan_deg, heading_deg=heading_deg).true.R_world_antenna
        theirs = rotation_matrix(mi.Point3f(*sionna_angles(R)[0].tolist())).numpy().reshape(3, 3)
        np.testing.assert_allclose(theirs, R[0], atol=2e-6)


def test_shapes_are_traced_back_to_our_surfaces(pencil):
    surfaces = [make_surface(lambda x, y, k=k: 0 * x + k, size_m=10.0, name=f"layer {k}") for k in range(3)]
    built = SionnaScene(make_scene(*surfaces), pencil, 77e9)
    down = mi.Ray3f(mi.Point3f(1.0, 2.0, [0.5, 1.5, 9.0]), mi.Vector3f(0, 0, -1))
    hit = built.rt_scene.mi_scene.ray_intersect(down)
    shape = dr.reinterpret_array(mi.UInt32, hit.shape).numpy()
    np.testing.assert_array_equal(built.surface_of_shape[shape], [0, 1, 2])


@pytest.mark.parametrize("model", [ConstantGammaBackscatter(0.02), LambertianBackscatter(0.3)])
def test_the_material_scatters_back_sigma0(model):
    """Each path's |a|^2 is lambda^2 G^2 sigma0 dA / ((4 pi)^3 r^4); the ratio to constant gamma leaves sigma0."""
    from dataclasses import replace

    from sionna_radar.tracing.engines.beam.beam import BeamEngine

    plain = make_scene(make_surface(lambda x, y: 0 * x), gamma=1.0)
    other = replace(plain, materials={"ground": model})
    power, incidence = [], None
    for scene in (plain, other):
        paths = BeamEngine(scene, make_antenna(60.0, 60.0), make_chirp(), 1, 4096, 0.05).trace(
            make_pulses(1, incidence_deg=40.0)
        )
        power.append(np.abs(paths.gain.astype(complex)) ** 2)
        incidence = np.arccos(50.0 / np.linalg.norm(paths.hit_m - [0, 0, 50], axis=1))
    near = incidence < np.deg2rad(85)
    expected = model.sigma0(incidence) / np.cos(incidence)
    np.testing.assert_allclose((power[1] / power[0])[near], expected[near], rtol=2e-3)
