"""Directions of an array whose range rates fold into one cell: closed forms, and what points are worth."""

import numpy as np
import pytest

from sionna_radar import load_scenario, prepare, run
from sionna_radar.radar.build import build_array, build_chirp
from sionna_radar.scenario.radar import RadarTable
from sionna_radar.survey.folded_directions import folded_likeness

ROW = [[0.5 * number, 0.0] for number in range(8)]
PENCIL = (1e-3, 1e-3)


def module(transmitters):
    array = {"transmitters_wavelengths": transmitters, "receivers_wavelengths": ROW, "multiplexing": "tdm"}
    radar = RadarTable(preset="ti_awr1843_array", array=array)
    return build_array(radar.array, build_chirp(radar), 1 / radar.chirp_rate_hz, 1)


def alike(array, speed_mps, half_view_deg=60.0):
    return folded_likeness(array, np.deg2rad(half_view_deg), PENCIL, np.array([0.0, 0.0, speed_mps]))


def test_one_transmitter_across_the_motion_tells_no_fold():
    array = module([[0.0, 0.0]])
    assert alike(array, 4 * array.highest_rate_mps) == pytest.approx(1.0, abs=1e-3)


def test_a_fold_out_of_view_confuses_nothing():
    array = module([[0.0, 0.0]])
    # The folded direction has the cosine 2 highest / speed along the motion.
    assert alike(array, 2.1 * array.highest_rate_mps) == 0.0
    assert alike(array, 4 * array.highest_rate_mps, half_view_deg=29.0) == 0.0
    assert alike(array, 0.0) == 0.0


def test_transmitters_in_turns_tell_a_fold_by_half_a_turn():
    """A fold turns every second chirp by half a turn, as a transmitter 4 wavelengths away does for 1/8 to a side."""
    array = module([[0.0, 0.0], [4.0, 0.0]])
    aside = np.linspace(1e-6, 0.5, 20_001)
    row = np.sin(8 * np.pi * aside / 2) / (8 * np.sin(np.pi * aside / 2))
    closed = np.max((np.cos(np.pi * (4 * aside - 0.5)) * row) ** 2)
    assert alike(array, 3 * array.highest_rate_mps) == pytest.approx(closed, rel=0.03)


@pytest.mark.parametrize(("speed_mps", "wrong"), [(6.0, False), (12.0, True)])
def test_points_that_fold_are_warned_of(speed_mps, wrong):
    """Two transmitters half a wavelength apart along the track: level ground, of which a fold makes heights."""
    array = {"transmitters_wavelengths": [[0.0, 0.0], [4.0, 0.5]], "receivers_wavelengths": ROW, "chirps": 32}
    changes = {
        "sensor": "mimo",
        "terrain": {"kind": "flat", "size_m": [300.0, 300.0]},
        "radar": {"preset": "ti_awr1843_array", "chirp_rate_hz": 8000.0, "array": array},
        "platform.altitude_m": 15.0,
        "platform.speed_mps": speed_mps,
        "platform.length_m": 0.8 * speed_mps,
        "tracing.paths_per_pulse": 2000,
    }
    prepared = prepare(load_scenario("hills", changes))
    survey = run(prepared)
    points = survey.points
    off_m = points.position_m[:, 2] - prepared.world.ground_m(points.position_m[:, :2])
    beyond = np.abs(off_m) > 5 * np.hypot(points.range_sigma_m, points.across_sigma_m)
    assert (beyond.mean() > 0.1) == wrong
    assert any("range rates fold" in warning for warning in survey.warnings) == wrong
