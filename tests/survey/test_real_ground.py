"""Surveys of ground that a lidar measured hold what they say of themselves; skipped where no file was fetched."""

import pytest

from map_checks import checked
from real_files import TAHOE, TOPOGRAPHY, real_file

GROUND = {TAHOE: {}, TOPOGRAPHY: {"terrain.kind": "points", "terrain.points": "ground"}}


@pytest.mark.parametrize("name", GROUND)
def test_a_map_of_measured_ground_holds_what_it_says(name):
    changes = GROUND[name] | {"terrain.path": str(real_file(name)), "platform.length_m": 60.0}
    for method, check in checked("own_dem", ("linear", "smooth"), changes).items():
        assert 0.85 < check.cells.coverage["95"] < 0.995, method
        assert check.cells.sigma_rms_m < 0.25, method
