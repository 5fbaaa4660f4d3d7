"""Beams over covers of different backscatter: by how much they move echoes, and what is said of it."""

import re

import numpy as np
import pytest
import trimesh
from scipy.stats import norm

from sionna_radar import load_scenario, prepare, run
from sionna_radar.survey.cover_shifts import cover_shifts

HALF = [[-400.0, -400.0], [0.0, -400.0], [0.0, 400.0], [-400.0, 400.0]]  # west of a border from south to north
DARK = {"model": "constant_gamma", "gamma_db": -30.0}


def ahead(**over):
    """Return a flight east over flat ground, its beam 45 deg ahead, that crosses the border."""
    flat = {"kind": "flat", "size_m": [400.0, 400.0], "spacing_m": 1.0}
    scan = {"radar.scan": {"mode": "fixed"}, "platform.start_m": [-60.0, 0.0], "platform.length_m": 20.0}
    return prepare(load_scenario("hills", {"terrain": flat, "materials.dark": DARK} | scan | over))


def covered(gamma_db):
    return {
        "terrain.cover": [{"polygon_m": HALF, "material": "dark"}],
        "materials.dark.gamma_db": gamma_db,
        "materials.ground": {"model": "constant_gamma", "gamma_db": -10.0},
    }


@pytest.mark.parametrize("contrast_db", [1.0, 6.0, 12.0])
def test_a_border_moves_echoes_as_in_a_gaussian_beam(contrast_db):
    prepared = ahead(**covered(-10.0 - contrast_db))
    shifts = cover_shifts(prepared)
    assert shifts is not None
    range_m, spread = 50.0 * np.sqrt(2), prepared.mapper.beam.spread[1]
    # Of height: of range on level ground, times the cosine of 45 deg, where the range changes as the angle does.
    s_m = range_m * spread * np.cos(np.pi / 4)
    # In the beam's angle; the far side, in the east, is the brighter one.
    u = (0.0 - shifts.place_m[:, 0]) * np.cos(np.pi / 4) / range_m / spread
    dark = 10 ** (-contrast_db / 10)
    expected_m = -s_m * (1 - dark) * norm.pdf(u) / (norm.sf(u) + dark * norm.cdf(u))
    near = np.abs(u) < 1.5
    assert near.sum() > 20
    # Of constant gamma at all, a lobe that ends, and 200 rays: within a tenth of the greatest shift.
    np.testing.assert_allclose(shifts.shift_m[near], expected_m[near], atol=0.1 * np.abs(expected_m).max())
    np.testing.assert_allclose(np.abs(shifts.shift_m[np.abs(u) > 6]).max(), 0.0, atol=1e-12)
    across = shifts.ratio > 1.01
    np.testing.assert_allclose(10 * np.log10(shifts.ratio[across]), contrast_db, rtol=1e-6)
    middle = np.argmin(np.abs(u))
    assert (shifts.brightest[middle], shifts.darkest[middle]) == ("ground", "dark")
    strength = np.sqrt(2 / np.pi) * s_m * (1 - dark) / (1 + dark)
    assert abs(shifts.shift_m[middle]) == pytest.approx(strength, rel=0.1)


def test_slabs_on_the_ground_count_as_covers_and_buildings_do_not(tmp_path):
    def shifts(high_m):
        trimesh.creation.box(bounds=[[-60, -60, 0], [0, 60, high_m]]).export(tmp_path / "slab.ply")
        slab = {"path": str(tmp_path / "slab.ply"), "position_m": [0.0, 0.0], "material": "dark"}
        return cover_shifts(ahead(objects=[slab], **{"materials.ground": DARK | {"gamma_db": -10.0}}))

    drawn, slab = cover_shifts(ahead(**covered(-30.0))), shifts(0.02)
    assert np.abs(drawn.shift_m).max() > 0.3
    # Borders of drawn covers follow the triangles of the ground, by up to 0.3 m.
    np.testing.assert_allclose(slab.shift_m, drawn.shift_m, atol=0.1)
    assert np.corrcoef(slab.shift_m, drawn.shift_m)[0, 1] > 0.99
    assert np.abs(shifts(6.0).shift_m).max() < 1e-9
    box = {"position_m": [-30.0, 0.0], "size_m": [120.0, 60.0, 6.0], "material": "dark"}
    assert np.abs(cover_shifts(ahead(buildings=[box])).shift_m).max() < 1e-9
    assert cover_shifts(ahead()) is None


def strips(contrast_db, **over):
    """Return the warnings and the errors of a short flight over strips of 12 m, and how far the echoes are moved."""
    corners = [[[-300, y], [300, y], [300, y + 12], [-300, y + 12]] for y in range(-162, 150, 24)]
    ground = {"model": "constant_gamma", "gamma_db": -10.0}
    scene = {
        "terrain.cover": [{"polygon_m": np.array(own, dtype=float).tolist(), "material": "dark"} for own in corners],
        "materials.dark": ground | {"gamma_db": -10.0 - contrast_db},
        "materials.ground": ground,
        "platform.length_m": 15.0,
        "tracing.paths_per_pulse": 128,
    }
    survey = run(load_scenario("hills", scene | over))
    return [told for told in survey.warnings if "covers of the ground" in told], survey


def test_covers_that_a_map_does_not_know_are_told_with_the_error_and_the_remedy():
    (told,), survey = strips(22.0)
    assert "differ by up to 22 dB ('ground' over 'dark' at" in told
    assert told.endswith("set dem.method = 'refined' and dem.cover = 'known', or narrow the beam")
    # The beams that covers move the most err as it says.
    share, error_m, stated_m = (
        float(number) for number in re.findall(r"in (\d+)%.* err by (\S+) m .*states (\S+) m;", told)[0]
    )
    shifts = cover_shifts(survey.prepared)
    row, column, _ = survey.dem.grid.cell_of(shifts.place_m)
    seen = np.isfinite(survey.error.height_m[row, column])
    most = np.argsort(-np.abs(shifts.shift_m[seen]))[: round(share / 100 * seen.sum())]
    found = (raster.height_m[row, column][seen][most] for raster in (survey.error, survey.dem_sigma))
    np.testing.assert_allclose([np.sqrt(np.mean(own**2)) for own in found], [error_m, stated_m], rtol=0.2)
    assert error_m > 1.5 * stated_m
    (told,), _ = strips(22.0, **{"dem.method": "smooth", "platform.length_m": 8.0})
    assert told.endswith("set dem.cover = 'known', or narrow the beam")
    (told,), _ = strips(22.0, **{"dem.cover": "known", "platform.length_m": 8.0})
    assert told.endswith("set dem.method = 'refined', or narrow the beam")


@pytest.mark.parametrize(
    ("contrast_db", "over"),
    [(22.0, {"dem.cover": "known", "dem.method": "smooth"}), (0.3, {"dem.method": "smooth"}), (0.3, {})],
)
def test_known_and_similar_covers_are_not_told(contrast_db, over):
    assert strips(contrast_db, **over)[0] == []
