"""What a page draws and says of a flight, against geometry worked out by hand, and its packed numbers."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from beams import make_antenna
from packed_pages import array_of, unpacked
from sionna_radar import load_scenario
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.foundation.sequences import spread_indices
from sionna_radar.report.page.beams import OUTLINE_RAYS, cast_beams, fan_of
from sionna_radar.report.page.scene_data import (
    EMPTY,
    MAX_FACES,
    Pack,
    flown_rows,
    sigma0_db,
    solids_within,
    standing,
    surroundings,
    thinned,
)
from sionna_radar.scene.footprints import Box, build_box
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.surfaces.backscatter import ConstantGammaBackscatter
from sionna_radar.survey.preparation import Prepared, prepare
from surveys import make_scenario
from worlds import make_scene, make_surface


@pytest.fixture(scope="module")
def level() -> Prepared:
    """A flight 50 m over the plane z = 0, tilted by 45 deg."""
    return prepare(make_scenario(60.0))


def test_the_axis_and_the_outline_of_a_beam_meet_the_plane_where_geometry_says(level):
    beams = cast_beams(level, spread_indices(20, len(level)))
    pose = beams.pulses.true
    expected = -pose.position_m[:, 2] / pose.boresight[:, 2]
    np.testing.assert_allclose(beams.distance_m[:, 0], expected, rtol=1e-5)
    assert np.abs(beams.hit_m[..., 2]).max() < 1e-3
    # Half power is half a beamwidth off the axis, in the two principal planes.
    outline = fan_of(level.instrument.antenna).direction[1 : 1 + OUTLINE_RAYS]
    off = np.arccos(outline[:: OUTLINE_RAYS // 4, 0])
    half = np.array(level.instrument.antenna.beamwidths_rad) / 2
    np.testing.assert_allclose(off, [half[0], half[1], half[0], half[1]], rtol=0.05)


def test_rays_stay_in_the_main_lobe_and_carry_its_gain():
    antenna = make_antenna(2.0, 4.0)
    fan = fan_of(antenna)
    assert fan.gain_db[0] == pytest.approx(0.0, abs=0.01)
    np.testing.assert_allclose(fan.gain_db[1 : 1 + OUTLINE_RAYS], -6.02, atol=0.6)  # twice half power
    assert fan.gain_db.min() > -25.0
    np.testing.assert_allclose(np.linalg.norm(fan.direction, axis=1), 1.0)


def test_sigma0_of_a_plane_is_that_of_its_material_at_the_incidence_of_the_nearest_axis(level):
    materials = dict(level.world.scene.materials)
    materials[level.world.scene.surfaces[0].material] = ConstantGammaBackscatter(0.01)
    world = replace(level, world=replace(level.world, scene=replace(level.world.scene, materials=materials)))
    grid = level.mapper.grid
    found = sigma0_db(world, Raster(grid=grid, height_m=np.zeros(grid.shape)))
    # The plain way for a few cells: every axis, the nearest hit, the angle at the cell.
    pose = level.flight.pulses(np.arange(len(level))).true
    hit = pose.position_m - pose.position_m[:, 2:] / pose.boresight[:, 2:] * pose.boresight
    for row, column in [(3, 4), (grid.rows // 2, grid.columns // 2), (grid.rows - 5, 7)]:
        cell = np.array([grid.x_m[column], grid.y_m[row], 0.0])
        nearest = np.argmin(np.linalg.norm(hit[:, :2] - cell[:2], axis=1))
        away = pose.position_m[nearest] - cell
        cosine = away[2] / np.linalg.norm(away)
        assert found[row, column] == pytest.approx(10 * np.log10(0.01 * cosine), abs=0.01)


def test_a_grid_is_thinned_to_what_is_allowed():
    thin = thinned(Grid(west_m=0.0, south_m=0.0, spacing_m=0.5, columns=1001, rows=777), 5_000)
    assert thin.cells.columns * thin.cells.rows <= 5_000
    values = np.arange(1001 * 777.0).reshape(777, 1001)
    assert thin.of(values).shape == thin.cells.shape
    assert f"every {thin.every}th cell" in thin.note
    assert thinned(thin.cells, 5_000).note == ""


def test_surroundings_meet_the_edge_of_the_map_and_leave_it_out(plane):
    inner = Grid(west_m=-10.0, south_m=-7.0, spacing_m=1.0, columns=21, rows=15)
    around = surroundings(RayCaster(plane.surfaces), plane, (-40.0, 40.0, -40.0, 40.0), 2_000, inner)
    assert {-10.0, 10.0} <= set(around.x_m.tolist())
    assert {-7.0, 7.0} <= set(around.y_m.tolist())
    x, y = np.meshgrid(around.x_m, around.y_m)
    inside = (x > -10) & (x < 10) & (y > -7) & (y < 7)
    assert np.abs(around.height_m[~inside]).max() < 1e-3
    assert np.isnan(around.height_m[inside]).any()
    assert np.nanmax(around.height_m[inside]) < -0.05


def test_buildings_stand_and_ground_lies():
    ground = make_surface(lambda x, y: 0.3 * x, size_m=200.0, spacing_m=10.0)
    box = build_box(Box(position_m=(0.0, 0.0), size_m=(10.0, 20.0, 8.0)), 0, lambda at: np.zeros(len(at)))
    scene = make_scene(ground)
    scene = replace(scene, surfaces=(*scene.surfaces, box))
    assert [standing(surface, "flat") for surface in scene.surfaces] == [False, True]
    found = solids_within(scene, "flat", (-50.0, 50.0, -50.0, 50.0))
    assert np.ptp(found.vertices_m[:, :2], axis=0).tolist() == [20.0, 10.0]
    assert found.note == ""
    assert solids_within(scene, "flat", (60.0, 80.0, 60.0, 80.0)) is None
    assert len(found.faces) < MAX_FACES
    roof = replace(ground, name="munich-3")
    assert standing(roof, "sionna:munich")
    assert not standing(ground, "sionna:munich")


@pytest.mark.parametrize(
    ("keys", "rate"), [({"radar.stagger": 0.5}, "288 Hz"), ({"processing.average.chirps": 4}, "90 Hz")]
)
def test_the_pulse_rate_is_that_of_pulses(keys, rate):
    scenario = load_scenario("hills", {"platform.length_m": 10.0, "terrain.spacing_m": 2.0, **keys})
    assert flown_rows(prepare(scenario))["Pulse rate"] == rate


@given(arrays(np.float64, (3, 4), elements=st.floats(-500, 500) | st.just(np.nan)), st.sampled_from([0.001, 0.1, 5.0]))
def test_rounded_values_come_back_within_half_a_step(values, step):
    pack = Pack()
    before, place, after = pack.exact(np.arange(3.0)), pack.rounded(values, step), pack.whole(np.array([7, -7]))
    document, arrays_ = unpacked(pack.text({"deep": [{"here": place}], "before": before, "after": after}))
    back = array_of(document["deep"][0]["here"], arrays_)
    known = values[np.isfinite(values)]
    coarse = max(step, np.ptp(known) / (EMPTY - 1)) if len(known) else step
    assert np.array_equal(np.isnan(back), np.isnan(values))
    assert np.nanmax(np.abs(back - values), initial=0.0) <= 0.5001 * coarse
    assert array_of(document["before"], arrays_).tolist() == [0.0, 1.0, 2.0]
    assert array_of(document["after"], arrays_).tolist() == [7.0, -7.0]


def test_text_in_a_pack_cannot_end_a_script():
    text = Pack().text({"name": "</script><script>alert(1)</script>", "none": float("nan")})
    assert "<" not in text
    assert unpacked(text)[0] == {"name": "</script><script>alert(1)</script>", "none": None}


def test_a_module_states_carrier_sweep_and_frames() -> None:
    """Chirps of each transmitter times transmitters, at 12 kHz; a pencil beam has pulses."""
    array = {"transmitters_wavelengths": [[0, 0], [1, 0]], "receivers_wavelengths": [[0, 0], [0.5, 0]], "chirps": 40}
    radar = {"chirp_rate_hz": 12_000.0, "carrier_hz": 79e9, "array": array | {"frame_rate_hz": 8.0}}
    changes = {"sensor": "mimo", "radar": radar | {"samples_per_chirp": 512, "bandwidth_hz": 300e6, "snr_db": 30.0}}
    scan = {"scan": {"mode": "fixed", "incidence_deg": 0.0}, "antenna": {"beamwidth_deg": [58.0, 40.0]}}
    changes["radar"] |= scan
    rows = flown_rows(
        prepare(load_scenario("hills", changes | {"platform.length_m": 4.0, "platform.altitude_m": 15.0}))
    )
    assert rows["Carrier"] == "79 GHz"
    assert rows["Sweep"] == "300 MHz, up"
    assert rows["Frame rate"] == "8 Hz"
    assert rows["Chirps of a frame"] == "80 chirps, 12 kHz"
    assert "Pulse rate" not in rows
    assert flown_rows(prepare(load_scenario("hills", {"platform.length_m": 4.0})))["Pulse rate"] == "360 Hz"
