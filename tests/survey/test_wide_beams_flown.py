"""Warnings of beams that are too wide: the bias of the echo in closed form, and intervals that do not hold."""

import numpy as np
import pytest

from sionna_radar import Raster, load_scenario, prepare, run
from sionna_radar.accuracy.truth import compare_dem
from sionna_radar.foundation.raster import Grid
from sionna_radar.radar.antenna import two_way_spread
from sionna_radar.survey.beam_bias import BeamBias, beam_bias, unmodelled_bias_warnings
from sionna_radar.survey.warnings import interval_warnings

LEVEL = {"terrain": {"kind": "flat", "size_m": [900.0, 900.0]}, "platform.length_m": 10.0}
NARROW = {"radar.scan.half_swath_deg": 2.0, "radar.samples_per_chirp": 4096}


@pytest.mark.parametrize(("beam_deg", "incidence_deg"), [(3.0, 20.0), (3.0, 60.0), (6.0, 55.0)])
def test_the_bias_over_level_ground_is_that_of_the_closed_form(beam_deg, incidence_deg):
    """r = h / cos: to second order in the beam's spread s, E[r] - r0 = r0 s^2 (1/2 - tan^2) with weights of r^-2.

    Across the track h / (cos a cos e): r0 s^2 / 2, without a first-order term.
    """
    over = {"radar.antenna.beamwidth_deg": beam_deg, "radar.scan.incidence_deg": incidence_deg}
    prepared = prepare(load_scenario("hills", LEVEL | NARROW | over))
    bias = beam_bias(prepared.flight, prepared.world, prepared.mapper.beam)
    across, along = two_way_spread(prepared.instrument.antenna)
    tan = np.tan(np.deg2rad(incidence_deg))
    # A side ray of direction (1, s, 0) is longer by half of s^2 and meets the ground as far down: r = r0 (1 + s^2 / 2).
    excess = along**2 * (0.5 - tan**2) + across**2 / 2
    expected_m = -50.0 * excess
    assert bias.typical_m == pytest.approx(abs(expected_m), rel=0.25)
    assert np.sign(bias.height_m.mean()) == np.sign(expected_m)


WIDE = {"radar.antenna.beamwidth_deg": 50.0, "platform.length_m": 10.0, "terrain.spacing_m": 2.0}


def test_a_beam_whose_bias_exceeds_a_cell_is_warned_of_before_the_flight():
    (only,) = prepare(load_scenario("hills", WIDE)).warnings
    assert "the beam of 50 by 50 deg is too wide for this flight" in only
    assert "more than a cell of the DEM (1 m)" in only
    assert prepare(load_scenario("hills", WIDE | {"dem.spacing_m": 10.0})).warnings == ()


def test_a_flown_map_states_too_little_of_a_wide_beam():
    over = {"radar.antenna.beamwidth_deg": [50.0, 3.0], "terrain.seed": 3, "platform.length_m": 20.0}
    warnings = run(load_scenario("hills", WIDE | over)).warnings
    assert any("the beam biases heights by" in warning for warning in warnings)
    assert any("the intervals of 95 % that `dem_sigma.tif` states contain" in warning for warning in warnings)


def test_pairs_of_sweeps_have_no_whole_echoes_and_are_warned_of_with_another_remedy():
    scan = {"mode": "conical", "incidence_deg": 60.0, "half_swath_deg": 30.0, "rotation_rpm": 240.0}
    keys = {"radar.antenna.beamwidth_deg": 6.0, "radar.scan": scan, "dem.method": "smooth", "platform.length_m": 25.0}
    told = {
        sweep: [
            text for text in run(load_scenario("ridges", keys | {"radar.sweep": sweep})).warnings if "biases" in text
        ]
        for sweep in ("triangular", "up")
    }
    (warning,) = told["triangular"]
    assert "set radar.sweep = 'up' and dem.method = 'refined', or narrow the beam" in warning
    assert told["up"] == []


GRID = Grid(west_m=0.0, south_m=0.0, spacing_m=1.0, columns=40, rows=30)


def test_a_bias_below_what_is_stated_is_not_warned_of():
    bias = BeamBias(
        place_m=np.array([[3.2, 4.1], [20.0, 20.0], [99.0, 99.0]]),
        height_m=np.array([0.3, -0.3, 40.0]),
        reach_m=np.ones(3),
    )
    sigma = Raster(grid=GRID, height_m=np.full(GRID.shape, 0.4))
    assert list(unmodelled_bias_warnings(bias, sigma)) == []
    less = Raster(grid=GRID, height_m=np.full(GRID.shape, 0.2))
    (only,) = unmodelled_bias_warnings(bias, less)
    assert "0.3 m RMS" in only
    assert list(unmodelled_bias_warnings(bias, None)) == []


HOUSE = {"position_m": [8.0, 3.0], "size_m": [12.0, 9.0, 7.0], "heading_deg": 20.0}
STEEP = {"radar.scan.incidence_deg": 25.0, "platform.length_m": 25.0, "platform.start_m": [-12.0, 0.0]}


def test_walls_are_no_slopes_that_bias_a_beam():
    """Over level ground and a level roof a beam of 2 deg errs by centimetres; across the roof's edges by metres."""
    prepared = prepare(load_scenario("buildings", STEEP | {"buildings": [HOUSE], "dem.method": "linear"}))
    bias = beam_bias(prepared.flight, prepared.world, prepared.mapper.beam)
    off_walls = bias.off_walls(prepared.truth.walls)
    assert np.abs(bias.height_m).max() > 1.0
    assert np.abs(off_walls.height_m).max() < 0.1
    assert len(off_walls.height_m) > 50
    # The main lobe meets level ground within 1.4 widths of its axis.
    assert np.median(off_walls.reach_m) == pytest.approx(50 * np.deg2rad(2.0) / np.cos(np.deg2rad(25)) ** 2, rel=0.4)
    sigma = Raster(grid=prepared.mapper.grid, height_m=np.full(prepared.mapper.grid.shape, 0.2))
    assert len(list(unmodelled_bias_warnings(bias, sigma))) == 1
    assert list(unmodelled_bias_warnings(off_walls, sigma)) == []


def test_a_map_across_walls_is_not_warned_of_slopes():
    survey = run(load_scenario("buildings", STEEP | {"buildings": [HOUSE], "dem.method": "linear"}))
    assert not any("biases heights" in warning for warning in survey.warnings)


@pytest.mark.parametrize(("factor", "warned"), [(1.0, False), (0.75, False), (0.5, True)])
def test_intervals_that_hold_less_than_four_fifths_are_warned_of(factor, warned):
    """Of Gaussian errors 1.96 sigma hold 95 %, those of three quarters of sigma 86 %, those of a half 67 %."""
    error_m = np.random.default_rng(2).normal(0, 0.3, GRID.shape)
    truth = Raster(grid=GRID, height_m=np.zeros(GRID.shape))
    compared = compare_dem(Raster(grid=GRID, height_m=error_m), truth, np.ones(GRID.shape, bool), None)
    found = list(interval_warnings(compared, Raster(grid=GRID, height_m=np.full(GRID.shape, 0.3 * factor))))
    assert bool(found) == warned


@pytest.mark.parametrize(("navigation_m", "warned"), [(None, True), (0.0, True), (0.1, True), (0.5, False)])
def test_errors_of_a_stated_navigation_are_no_fault_of_the_map(navigation_m, warned):
    """A map that is off by 0.4 m as a whole, of which its own uncertainty states 0.1 m."""
    error_m = np.random.default_rng(5).normal(0.4, 0.1, GRID.shape)
    truth = Raster(grid=GRID, height_m=np.zeros(GRID.shape))
    compared = compare_dem(Raster(grid=GRID, height_m=error_m), truth, np.ones(GRID.shape, bool), None)
    own, shared = (
        None if sigma_m is None else Raster(grid=GRID, height_m=np.full(GRID.shape, sigma_m))
        for sigma_m in (0.1, navigation_m)
    )
    found = list(interval_warnings(compared, own, shared))
    assert bool(found) == warned
    assert all(("dem_sigma_navigation.tif" in warning) == (navigation_m is not None) for warning in found)
