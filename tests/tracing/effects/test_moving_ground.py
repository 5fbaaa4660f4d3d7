"""Ground that the wind moves: the field's correlation and spectrum, whichever engine traces it, in any blocks."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.constants import g as gravity
from scipy.constants import speed_of_light

from beams import make_antenna, make_chirp
from flights import make_pulses
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.surfaces.motion import TENSION_M3_PER_S2, SurfaceMotion, Waves, Windblown
from sionna_radar.tracing.engines.gamma.facets import GammaEngine
from sionna_radar.tracing.engines.persistent.persistent import PersistentEngine
from sionna_radar.tracing.tracer import build_moving_ground
from worlds import make_scene, make_surface

WIND_MPS = np.array([3.0, 4.0, 0.0])


def ground(kind=None, **given):
    scene = make_scene(make_surface(lambda x, y: 0 * x, size_m=200.0, spacing_m=2.0))
    if kind is None:
        return scene
    return replace(scene, motions={scene.surfaces[0].material: SurfaceMotion(kind=kind, **given)})


@pytest.fixture(scope="module", params=["sionna", "gamma"])
def engine(request):
    scene, antenna, chirp = ground(), make_antenna(8.0, 8.0), make_chirp()
    if request.param == "sionna":
        return PersistentEngine(scene, antenna, chirp, 1, 40.0, outer_rays=1)
    return GammaEngine(scene, antenna, chirp, 1, RayCaster(scene.surfaces))


def over_time(engine, moving, time_s, incidence_deg=30.0):
    """Return paths of a radar that stands still, at times."""
    pulses = make_pulses(len(time_s), incidence_deg=incidence_deg, position_m=(0.0, -30.0, 50.0))
    pulses = replace(pulses, time_s=time_s)
    paths = engine.trace(pulses)
    return pulses, paths, moving.moved(paths, pulses)


def test_plants_lose_their_correlation_as_billingsley_has_it(engine):
    lag_s = np.array([0.0, 1e-3, 3e-3, 10e-3, 1.0])
    moving = build_moving_ground(ground("plants"), WIND_MPS, make_chirp(), 3)
    pulses, still, moved = over_time(engine, moving, 100.0 + lag_s)
    turned, row = moved.gain / still.gain, pulses.row_of(moved.pulse)
    names = [tuple(place) for place in np.round(moved.hit_m, 3)]
    each = list(zip(names, turned, row, strict=True))
    first = {name: turn for name, turn, own in each if own == 0}
    products = [
        [
            np.conj(first[name]) * turn
            for name, turn, own in zip(names, turned, row, strict=True)
            if own == k and name in first
        ]
        for k in range(len(lag_s))
    ]
    assert min(map(len, products)) > 500
    expected = Windblown.of(5.0, make_chirp().carrier_hz).field_correlation(lag_s)
    np.testing.assert_allclose([np.mean(one).real for one in products], expected, atol=0.1)


def test_neither_blocks_nor_order_change_what_a_scatterer_does(engine):
    for kind in ("plants", "water"):
        moving = build_moving_ground(ground(kind), WIND_MPS, make_chirp(), 3)
        pulses, still, whole = over_time(engine, moving, np.linspace(0.0, 1.0, 5))
        last = pulses.rows(slice(4, 5))
        alone = moving.moved(still.rows(still.pulse == last.index[0]), last)
        np.testing.assert_array_equal(alone.gain, whole.gain[whole.pulse == last.index[0]])
        np.testing.assert_array_equal(alone.delay_s, whole.delay_s[whole.pulse == last.index[0]])


def test_ranges_follow_the_waves_and_phases_the_ripples(engine):
    chirp, step_s = make_chirp(), 1e-3
    moving = build_moving_ground(ground("water", fetch_m=500.0), WIND_MPS, chirp, 3)
    pulses, still, moved = over_time(engine, moving, np.array([10.0, 10.0 + step_s]))
    row = pulses.row_of(moved.pulse)
    away = moved.hit_m - pulses.true.position_m[row]
    sight = away / np.linalg.norm(away, axis=1)[:, None]
    # The waves alone, off whose surface every scatterer is carried.
    offset, velocity = Waves.of(WIND_MPS[:2], 500.0, 3).moved(moved.hit_m.astype(float), pulses.time_s[row])
    range_m = (moved.delay_s - still.delay_s) * speed_of_light / 2
    np.testing.assert_allclose(range_m, np.sum(offset * sight, axis=1), atol=1e-6)
    assert 0.01 < range_m.std() < 0.2
    # What is left of range rates and phases are the ripples: two lines, of gravity and tension.
    left = moved.range_rate_mps - still.range_rate_mps - np.sum(velocity * sight, axis=1)
    wave_per_m = 4 * np.pi / chirp.wavelength_m * np.hypot(*sight[:, :2].T)
    line_hz = np.sqrt(gravity * wave_per_m + TENSION_M3_PER_S2 * wave_per_m**3) / (2 * np.pi)
    np.testing.assert_allclose(np.abs(left) * 2 / chirp.wavelength_m, line_hz, rtol=1e-2)
    turns = np.mod(
        np.angle(moved.gain / still.gain) / (2 * np.pi) + 2 * left / chirp.wavelength_m * pulses.time_s[row], 1
    )
    assert np.minimum(turns, 1 - turns).max() < 0.02
    # The wind blows across the sight, and a little along it.
    assert np.mean(left < 0) == pytest.approx(
        np.mean(1 - sight[:, :2] @ WIND_MPS[:2] / 5 / np.hypot(*sight[:, :2].T)) / 2, abs=0.05
    )


def test_still_scenes_and_calm_air_cost_nothing():
    assert build_moving_ground(ground(), WIND_MPS, make_chirp(), 1) is None
    assert build_moving_ground(ground("plants"), np.zeros(3), make_chirp(), 1) is None
