"""Published radars: their figures stand where none are given, and give way to those that are."""

import numpy as np
import pytest

from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.radar.build import build_antenna, build_array, build_chirp
from sionna_radar.scenario.presets import PRESETS
from sionna_radar.scenario.radar import RadarTable


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_is_a_radar_with_sources(name):
    radar = RadarTable(preset=name)
    assert PRESETS[name].sources
    assert PRESETS[name].assumed
    assert build_chirp(radar).carrier_hz == PRESETS[name].keys["carrier_hz"]
    if radar.array is None:
        assert 0 < min(radar.antenna.beamwidths_rad) <= max(radar.antenna.beamwidths_rad) < 1.1
    again = RadarTable(**radar.model_dump(mode="json", exclude_none=True))
    assert again == radar


def test_what_is_given_comes_first():
    radar = RadarTable(preset="avtis2", bandwidth_hz=400e6, antenna={"side_lobe_db": -30.0})
    assert (radar.carrier_hz, radar.bandwidth_hz) == (94e9, 400e6)
    assert (radar.antenna.beamwidth_deg, radar.antenna.side_lobe_db) == (0.35, -30.0)
    assert RadarTable(preset="avtis2", snr_db=20.0).transmit_power_dbm is None
    assert RadarTable(preset="uw_scat_ku", transmit_power_dbm=10.0, noise_figure_db=8.0).snr_db is None
    assert RadarTable(preset="avtis2", antenna={"elements": [8, 8]}).antenna.kind == "array"
    assert RadarTable(preset="avtis2", scan={"mode": "fixed", "incidence_deg": 10.0}).scan.incidence_deg == 10.0


def test_range_resolutions_are_the_published_ones():
    """AVTIS: below a metre, about 7 km; UW-Scat: 30 cm; the paper: 0.30 m."""
    cells = {name: build_chirp(RadarTable(preset=name)) for name in PRESETS}
    assert cells["avtis2"].range_resolution_m == pytest.approx(0.75, rel=1e-3)
    assert cells["avtis2"].max_range_m > 7000
    assert cells["uw_scat_ku"].range_resolution_m == pytest.approx(0.30, rel=1e-3)
    assert cells["rouveure_2017"].range_resolution_m == pytest.approx(0.30, rel=1e-3)


def test_an_unknown_preset_is_refused():
    with pytest.raises(ScenarioError, match=r"preset: 'avtis' is unknown; .* Did you mean avtis2"):
        RadarTable(preset="avtis")


def test_the_elements_of_modules_have_the_published_patterns_and_places():
    """Two-way 2 to 4 dB down at 30 deg and 12 to 16 at 60; virtual arrays of 8 and of 86 places across."""
    for name, across in (("ti_awr1843_array", 8), ("ti_awr2243_cascade", 86)):
        radar = RadarTable(preset=name)
        antenna = build_antenna(radar.antenna)
        array = build_array(radar.array, build_chirp(radar), 1 / radar.chirp_rate_hz, 1)
        angle = np.deg2rad([0.0, 30.0, 60.0])
        two_way = antenna.gain(np.column_stack([np.cos(angle), np.sin(angle), np.zeros(3)])) ** 2
        assert -4 < 10 * np.log10(two_way[1] / two_way[0]) < -2
        assert -16 < 10 * np.log10(two_way[2] / two_way[0]) < -12
        assert 2 * np.deg2rad(13) < antenna.beamwidths_rad[1] < 2 * np.deg2rad(15)
        level = array.virtual_m[np.isclose(array.virtual_m[:, 2], array.virtual_m[:, 2].min())]
        assert len(np.unique(np.round(level[:, 1] / array.wavelength_m, 3))) == across
        assert array.widest_gap_wavelengths == pytest.approx(0.5, abs=0.01)


def test_parts_of_an_array_are_merged_with_the_preset():
    array = RadarTable(preset="ti_awr1843_array", array={"chirps": 32, "multiplexing": "bpm"}).array
    assert (array.chirps, array.chirps_per_frame, len(array.receivers_wavelengths)) == (32, 128, 4)
