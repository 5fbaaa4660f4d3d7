"""What the rest of a scenario must be for angles of arrival."""

import pytest

from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.scenario import load_scenario

ON = {"processing.angle": "interferometric", "radar.second_receiver.axis": "both"}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"processing.angle": "monopulse"}, "processing.angle: 'monopulse' needs radar.second_receiver with kind"),
        (ON | {"radar.second_receiver.kind": "monopulse"}, "needs radar.second_receiver with kind = 'interferometer'"),
        (
            ON | {"radar.sweep": "triangular"},
            "processing.angle: 'interferometric' is not supported with pairs of sweeps",
        ),
        (
            ON | {"sensor": "lidar"},
            "processing.angle: 'interferometric' is not supported with a sensor",
        ),
        (ON | {"weather.rain_rate_mm_per_h": 5.0}, "is not supported with rain, snow or dust"),
        (ON | {"dem.method": "refined"}, "dem.method: 'refined' is not supported with several receivers"),
        (
            ON | {"radar.scan.mode": "electronic", "radar.antenna": {"kind": "array", "elements": [16, 16]}},
            "is not supported with electronically steered beams",
        ),
        ({"processing.angle_length_m": 2.0}, "processing.angle_length_m: 2 has no effect with angle = 'off'"),
    ],
)
def test_what_does_not_fit_is_refused(changes, said):
    with pytest.raises(ScenarioError, match=said):
        load_scenario("hills", changes)


def test_over_buildings_points_are_interpolated():
    """The map that breaks at walls models whole echoes, of which points are not made."""
    assert load_scenario("buildings").dem.method == "stepped"
    assert load_scenario("buildings", ON).dem.method == "linear"
