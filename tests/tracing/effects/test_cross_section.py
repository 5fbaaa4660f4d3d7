"""What no cross-section of a shape can be asked for; its values are in `test_bodies`."""

import numpy as np
import pytest

from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.scenario.objects import TargetMesh
from sionna_radar.tracing.build import rcs_of_mesh


@pytest.mark.parametrize(
    ("name", "value"), [("range_m", 0.0), ("range_m", -1.0), ("range_m", np.nan), ("carrier_hz", 0.0)]
)
def test_a_cross_section_from_nowhere_is_refused(name, value):
    given = {"carrier_hz": 77e9, "range_m": 100.0, name: value}
    with pytest.raises(ScenarioError, match=rf"{name}: .* is not positive and finite"):
        rcs_of_mesh(TargetMesh(path="none.ply"), azimuth_rad=np.zeros(1), elevation_rad=np.zeros(1), **given)
