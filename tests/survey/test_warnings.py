"""What a reader is told beside the numbers."""

import pytest

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
