"""What a reader is told beside the numbers."""

import pytest

from sionna_radar.scenario.weather import WeatherTable
from sionna_radar.survey.warnings import warnings_of


@pytest.mark.parametrize(("falling", "told"), [("rain", False), ("air", True)])
def test_clear_air_that_seems_to_send_something_back_has_a_remedy_of_its_own(falling, told):
    """A receiver as it is built may leave a floor that looks like rain."""
    both = list(warnings_of(100, 0, 50, 100, falling, stepped_behind_volume=True))
    assert len(both) == 2
    for text in both:
        assert text.startswith(f"{falling}: ")
        assert ("processing.volume_clutter = 'off'" in text) == told


def test_few_lost_pulses_are_not_told():
    assert list(warnings_of(100, 0, 1, 100)) == []
    assert len(list(warnings_of(0, 0, 1, 100, window_key="processing.expected_ground"))) == 1


@pytest.mark.parametrize(
    ("weather", "filling"),
    [
        ({}, ""),
        ({"dust_visibility_m": 20.0}, "dust"),
        ({"rain_rate_mm_per_h": 2.0, "fog": "thick"}, "rain and fog"),
        ({"liquid_water_g_per_m3": 0.2}, "fog"),
        ({"fog_visibility_m": 100.0, "smoke_visibility_m": 50.0}, "fog and smoke"),
    ],
)
def test_what_fills_the_air_has_its_name(weather, filling):
    """Nobody who asked for fog or dust is told that the air may be clear."""
    assert WeatherTable(**weather).filling == filling
