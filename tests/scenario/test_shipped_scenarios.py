"""What the shipped scenarios must show, flown as they are shipped."""

import numpy as np
import pytest

from sionna_radar import load_scenario, run


@pytest.fixture(scope="module")
def hills():
    return run(load_scenario("hills"))


def test_hills_beat_the_paper(hills):
    """Rouveure et al. 2017, Fig. 12 and Table 3: 0.29 m RMS at a beam of 2 deg."""
    assert hills.dem_error.rms_m <= 0.29
    assert hills.dem_error.count > 10_000
    assert hills.dem_error.coverage > 0.85


def test_the_papers_method_gives_the_papers_error():
    """The strongest bin on the beam axis: the paper's 0.29 m within a fifth."""
    error = run(load_scenario("hills", {"processing.ranging": "peak"})).dem_error
    assert error.rms_m == pytest.approx(0.29, rel=0.25)


def test_roof_edge_shows_roof_and_ground():
    """Two echoes in every chirp, within 0.3 m of the beam-weighted ranges of what the beam lights (paper Fig. 9)."""
    survey = run(load_scenario("roof_edge"))
    points = survey.points
    assert np.all(np.bincount(points.pulse, minlength=survey.pulses) == 2)
    for number, expected in enumerate(beam_weighted_ranges()):
        measured = points.range_m[points.number == number]
        assert np.median(measured) == pytest.approx(expected, abs=0.1)
        assert np.mean(np.abs(measured - expected) < 0.3) > 0.8
    assert beam_weighted_ranges() == pytest.approx([36.4, 44.0], abs=0.1)


def beam_weighted_ranges() -> list[float]:
    """Mean ranges of the lit parts of roof and ground, by quadrature over the two-way beam in plane geometry."""
    scenario = load_scenario("roof_edge")
    building = scenario.buildings[0]
    roof_m, edge_m = building.size_m[2], building.position_m[0] + building.size_m[0] / 2
    angle = np.linspace(-0.05, 0.05, 4001)
    # Two-way Gaussian of the same half-power width: the power falls to a quarter at half the width.
    weight = 0.5 ** (2 * (2 * angle / np.deg2rad(scenario.radar.antenna.beamwidth_deg)) ** 2)
    down = np.cos(np.deg2rad(scenario.radar.scan.incidence_deg) + angle)
    along = np.sqrt(1 - down**2)
    height = scenario.platform.altitude_m
    on_roof = along / down * (height - roof_m) < edge_m
    range_m = np.where(on_roof, height - roof_m, height) / down
    weight = weight / range_m**2  # a beam-filling surface: sigma0 A / r^4, A growing with r^2
    return [float(np.average(range_m[part], weights=weight[part])) for part in (on_roof, ~on_roof)]


def test_jacksboro_is_georeferenced_and_sane():
    survey = run(load_scenario("jacksboro"))
    assert survey.dem_error.rms_m < 0.3
    assert survey.georeference is not None
    assert "UTM zone 16N" in survey.georeference.crs_wkt


def test_demo_sees_roofs_and_the_hills_between():
    survey = run(load_scenario("demo"))
    assert survey.scenario.dem.method == "stepped"
    lit = survey.lit_error
    assert lit.coverage > 0.9
    assert lit.nmad_m < 0.05
    assert lit.over_1m < 0.01
    assert np.ptp(survey.dem.height_m[survey.dem.filled]) > 10.0


def test_san_francisco_has_streets_and_roofs():
    lines = {"count": 1, "spacing_m": 50.0, "length_m": 5.0, "centre_m": [300.0, 30.0]}
    survey = run(load_scenario("san_francisco", {"platform.lines": lines, "radar.scan.rotation_rpm": 240.0}))
    assert survey.scenario.dem.method == "stepped"
    assert survey.lit_error.nmad_m < 0.15
    heights = survey.dem.height_m[survey.dem.filled]
    assert np.ptp(heights) > 10.0


def test_maize_is_read_among_its_plants_and_soil_on_the_ground():
    survey = run(load_scenario("maize"))
    share = survey.prepared.world.scene.vegetation.fraction_over(survey.truth.grid)
    bare = survey.error.filled & (share == 0)
    among = survey.error.filled & (share > 0.5)
    assert np.sum(bare) > 800
    assert np.sum(among) > 400
    assert np.sqrt(np.mean(survey.error.height_m[bare] ** 2)) < 0.15
    assert 0.3 < survey.error.height_m[among].mean() < 0.9
    assert survey.canopy_reading.height_m == pytest.approx(1.1, abs=0.03)
