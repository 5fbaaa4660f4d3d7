"""Stated uncertainties over real ground: `SIONNA_RADAR_DEMS=folder pytest -m study -n 0 -s -k real_ground_study`.

The folder holds elevation rasters of 2 m spacing or finer, some 250 m wide, in two folders: `chosen/*.tif`, on which
constants may be chosen, and `reported/*.tif`, on which none was. Without it the study is skipped.
"""

import os
from pathlib import Path

import numpy as np
import pytest
import rasterio

from map_checks import NOMINAL, checked, shares
from sionna_radar.accuracy.uncertainty import UncertaintyCheck

pytestmark = pytest.mark.study

FOLDER = os.environ.get("SIONNA_RADAR_DEMS", "")
HALVES = ("chosen", "reported")
FILES = [path for half in HALVES for path in sorted(Path(FOLDER, half).glob("*.tif"))] if FOLDER else []
SEEDS = range(1, 1 + int(os.environ.get("SIONNA_RADAR_SEEDS", "2")))
METHODS = ("linear", "smooth", "refined")
NARROW_M = 250.0


def flight_over(path: Path) -> dict[str, object]:
    """A flight that stays over a file: shorter and narrower over a small one."""
    with rasterio.open(path) as file:
        north_m, east_m = file.height * file.res[1], file.width * file.res[0]
    changes: dict[str, object] = {"terrain.path": str(path)}
    if min(north_m, east_m) < NARROW_M:
        changes |= {"platform.length_m": 60.0, "radar.scan.half_swath_deg": 25.0}
    return changes


@pytest.fixture(scope="module")
def ground() -> dict[str, list[tuple[str, UncertaintyCheck]]]:
    """Every file and seed by method, with the half that it is in."""
    if not FILES:
        pytest.skip("set SIONNA_RADAR_DEMS to a folder of elevation rasters")
    found: dict[str, list[tuple[str, UncertaintyCheck]]] = {name: [] for name in METHODS}
    for path in FILES:
        for seed in SEEDS:
            print(path.parent.name, path.stem)
            for name, check in checked("own_dem", METHODS, flight_over(path) | {"seed": seed}).items():
                found[name].append((path.parent.name, check))
    return found


@pytest.mark.parametrize("method", METHODS)
def test_intervals_over_real_ground_hold_what_they_say(ground, method):
    """95 % intervals hold 85 % of every survey at least, and no more than half a percent of cells lie beyond 5 sigma.

    Eight lidar DEMs at 0.5 to 2 m, two seeds each, 2 deg (`docs/checks/uncertainty.md`).
    """
    for half in HALVES:
        own = [check for which, check in ground[method] if which == half]
        if own:
            covered = shares(own)
            within = np.mean(np.abs(covered - NOMINAL).max(axis=1) < 0.08)
            print(f"{method}, {half}: {np.round(100 * covered.mean(axis=0), 1)} %, within 8 points {within:.0%}")
    every = [check for _, check in ground[method]]
    assert shares(every)[:, 3].min() > 0.85
    assert np.sqrt(np.mean([check.cells.rms_z**2 for check in every])) < 1.5
