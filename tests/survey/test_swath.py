"""What a survey maps of the swath that was planned, and the warning of a beam that returns to the same angles."""

import numpy as np
import pytest

from sionna_radar import run
from sionna_radar.scenario import load_scenario
from sionna_radar.studies.sweep.quantities import quantities_of
from sionna_radar.survey.preparation import prepare
from sionna_radar.survey.swath import mapped_ground, planned_swath, way_flown_m

FLAT = {"terrain": {"kind": "flat", "size_m": [500.0, 500.0]}, "materials.ground.model": "constant_gamma"}
BEAM, RPM, RATE = "radar.antenna.beamwidth_deg", "radar.scan.rotation_rpm", "radar.chirp_rate_hz"


def flat(**changed):
    """Return a survey over level ground, ready to fly; keys with __ for dots."""
    return prepare(load_scenario("hills", FLAT | {key.replace("__", "."): value for key, value in changed.items()}))


def says(prepared):
    return [text for text in prepared.warnings if "chirps a turn" in text]


@pytest.mark.parametrize(
    "changed",
    [
        {"platform__length_m": 60.0},
        {"platform__length_m": 60.0, "radar__scan__half_swath_deg": 30.0, "radar__scan__incidence_deg": 20.0},
        {"radar__scan__mode": "conical", "radar__scan__half_swath_deg": 60.0, "dem__spacing_m": 0.5},
        {"radar__scan__mode": "fixed", "radar__antenna__beamwidth_deg": 10.0, "platform__heading_deg": 0.0},
        {"radar__scan__mode": "fixed", "radar__scan__incidence_deg": 20.0, "radar__antenna__beamwidth_deg": 12.0},
    ],
)
def test_the_planned_swath_over_level_ground_is_that_of_the_closed_form(changed):
    """A curve as wide as the swath, moved along a straight track, sweeps width times length, and its own depth."""
    prepared = flat(**changed)
    grid, cells = planned_swath(prepared)
    width_m, length_m = quantities_of(prepared.scenario, None, ["swath_m"])["swath_m"], way_flown_m(prepared.flight)
    assert length_m == pytest.approx(prepared.scenario.platform.length_m)
    area_m2 = cells.sum() * grid.spacing_m**2
    depth_m = (
        1.5 * prepared.plan.flown.altitude_m * np.tan(np.max(prepared.instrument.antenna.beamwidths_rad))
        + 2 * grid.spacing_m
    )
    fixed = prepared.scenario.radar.scan.mode == "fixed"
    assert width_m * length_m * 0.98 < area_m2
    assert area_m2 < (width_m + 2 * grid.spacing_m) * (length_m + (depth_m if fixed else 2 * grid.spacing_m))


def test_a_map_of_part_of_the_swath_covers_that_share():
    prepared = flat(platform__length_m=60.0)
    north_m = prepared.mapper.grid.centres_m[:, 1].reshape(prepared.mapper.grid.shape)
    whole, half = (mapped_ground(prepared, part) for part in (np.ones_like(north_m, bool), north_m > 0))
    assert whole.coverage_of_swath > 0.97
    assert half.coverage_of_swath == pytest.approx(0.5, abs=0.02)
    assert half.mapped_m2 == (north_m > 0).sum()
    assert half.mapped_swath_m == pytest.approx(half.mapped_m2 / 60)
    hovering = flat(platform__length_m=0.9, radar__scan__rotation_rpm=900.0)
    assert np.isnan(mapped_ground(hovering, np.zeros(hovering.mapper.grid.shape, bool)).mapped_swath_m)


def test_ground_that_is_left_dark_is_not_covered():
    """Of 38 angles a turn, always the same, 11 lie within the sector, and its sides stay dark; 37.6 reach them."""
    given = {"platform.length_m": 30.0, RATE: 266.0, BEAM: 4.0, "radar.scan.half_swath_deg": 51.0}
    given["dem.method"] = "smooth"
    dark, lit = (run(load_scenario("hills", given | {RPM: rpm})) for rpm in (420.0, 424.5))
    assert dark.lit_error.coverage > lit.lit_error.coverage - 0.02
    assert dark.mapped.coverage_of_swath < lit.mapped.coverage_of_swath - 0.05
    assert dark.mapped.mapped_m2 < 0.95 * lit.mapped.mapped_m2
    assert any("chirps a turn" in text for text in dark.warnings)
    assert not any("chirps a turn" in text for text in lit.warnings)


def dark_share(prepared):
    """Return the share of angles of the sector that no beam reaches, counted pulse by pulse from the schedule.

    A place of level ground in the middle of the scan is looked at while it is within half a footprint of the beam.
    """
    scan, (azimuth_rad, elevation_rad) = prepared.flight.scan, prepared.instrument.antenna.beamwidths_rad
    down = np.cos(scan.incidence_rad)
    width_rad = azimuth_rad / (np.sin(scan.incidence_rad) if scan.mode == "conical" else down)
    seconds = prepared.plan.flown.altitude_m / down**2 * elevation_rad / prepared.plan.flown.speed_mps
    turns = int(seconds * scan.rotation_rad_s / (2 * np.pi))
    pulses = prepared.flight.pulses(np.arange(len(prepared)))
    first = int(pulses.scan_number.min()) + 1
    seen = np.sort(pulses.scan_rad[(pulses.scan_number >= first) & (pulses.scan_number < first + turns)])
    inner = seen[(seen > -0.6) & (seen < 0.6)]
    gaps = np.diff(inner)
    return float(np.maximum(gaps - width_rad, 0).sum() / np.ptp(inner)), turns


@pytest.mark.parametrize("stagger", [0.0, 0.3])
@pytest.mark.parametrize("mode", ["whisk_broom", "conical"])
def test_repeated_angles_are_warned_of_where_the_schedule_leaves_gaps(mode, stagger):
    """All that is warned of is dark; near a whole number of chirps a turn all that is dark is warned of."""
    random = np.random.default_rng(4)
    warned = missed = 0
    for chirps in [*(30 + random.integers(0, 20, 8) + random.normal(0, 0.05, 8)), *random.uniform(30, 50, 8)]:
        changed = {"radar__scan__mode": mode, "radar__stagger": stagger, "platform__length_m": 25.0}
        changed |= {"radar__scan__half_swath_deg": 50.0, "radar__chirp_rate_hz": 300.0}
        rpm = 60 * 300.0 / (1 + stagger / 2) / float(chirps)
        prepared = flat(**changed, radar__antenna__beamwidth_deg=3.5, radar__scan__rotation_rpm=rpm)
        share, turns = dark_share(prepared)
        together = 2 if stagger else 1
        near_whole = abs(chirps - together * round(chirps / together)) * turns < 0.5
        assert turns >= 2
        if says(prepared):
            warned += 1
            assert share > 0
        elif near_whole:
            missed += share > 0.02
    assert warned >= 2
    assert missed == 0


def test_the_speed_that_a_warning_names_leaves_no_gap():
    prepared = flat(radar__antenna__beamwidth_deg=3.0, radar__scan__rotation_rpm=540.0)
    (text,) = says(prepared)
    better = float(text.split("rotation_rpm = ")[2].split(",")[0])
    assert dark_share(prepared)[0] > 0.3
    better = flat(radar__antenna__beamwidth_deg=3.0, radar__scan__rotation_rpm=better)
    assert says(better) == []
    assert dark_share(better)[0] < 0.01
