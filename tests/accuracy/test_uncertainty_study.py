"""Stated uncertainties against the errors of whole surveys: `pytest -m study -n 0 -s -k uncertainty_study`.

Each case is flown once over still ground (its speckle stays), and mapped by each method. `SIONNA_RADAR_SEEDS=5` takes
all seeds of the full table, half an hour on two quiet cores; without it there is one, ten minutes.
"""

import os
from itertools import pairwise

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from elevation_files import NORTH, WEST, from_origin, write_heights
from map_checks import NOMINAL, checked, shares
from sionna_radar import load_scenario, run
from sionna_radar.accuracy.uncertainty import UncertaintyCheck, WindowMeans

pytestmark = pytest.mark.study

SEEDS = range(1, 1 + int(os.environ.get("SIONNA_RADAR_SEEDS", "1")))
SCENES, BEAMS_DEG = ("hills", "ridges", "jacksboro", "fractal"), (1.0, 2.0, 4.0, 8.0)


@pytest.fixture(scope="module")
def grid():
    """Every case of the grid, by scene and beam, for `smooth` and `refined`."""
    found: dict[str, dict[tuple[str, float], list[UncertaintyCheck]]] = {"smooth": {}, "refined": {}}
    for seed in SEEDS:
        for scene in SCENES:
            for beam in BEAMS_DEG:
                changes = {"radar.antenna.beamwidth_deg": beam, "seed": seed}
                if scene != "jacksboro":
                    changes["terrain.seed"] = seed
                for name, check in checked(scene, ("smooth", "refined"), changes).items():
                    found[name].setdefault((scene, beam), []).append(check)
    return found


@pytest.mark.parametrize("method", ["smooth", "refined"])
def test_intervals_hold_what_they_say(grid, method):
    """The mean over all cases within 5 points (3 are wanted), and every case within 16.

    With five seeds: 53.0, 71.3, 91.3, 95.5 % (`smooth`) and 54.2, 72.0, 91.3, 95.3 % (`refined`), the worst case 8 and
    9 points off. Of one seed alone no more than 94 % of the cases could be within 8 (`docs/checks/uncertainty.md`), so
    that fewer seeds bind less.
    """
    cases = np.array([shares(case).mean(axis=0) for case in grid[method].values()])
    mean, worst = cases.mean(axis=0), np.abs(cases - NOMINAL).max(axis=1)
    spread = np.mean([check.cells.nmad_z for case in grid[method].values() for check in case])
    print(f"{method}: mean {np.round(100 * mean, 1)} %, NMAD of z {spread:.2f}")
    print(f"  cases beyond 8 points {np.mean(worst > 0.08):.0%}, the worst by {100 * worst.max():.0f}")
    for (scene, beam), case in grid[method].items():
        print(f"  {scene} {beam:g} deg: {np.round(100 * shares(case).mean(axis=0), 1)}")
    assert np.abs(mean - NOMINAL).max() < 0.05 + 0.02 * (len(SEEDS) < 3)
    assert worst.max() < 0.16 if len(SEEDS) >= 5 else np.mean(worst < 0.12) > 0.8
    assert 0.9 < spread < 1.1


@pytest.mark.xfail(len(SEEDS) > 1, reason="one terrain of `fractal` (seed 2), 4 and 8 deg: 83, 78, 83 and 81 % in 95")
@pytest.mark.parametrize("method", ["smooth", "refined"])
def test_no_survey_is_far_off(grid, method):
    """Over 85 % in 95; all others of 80 surveys hold 87.7 % and more."""
    assert min(shares(case)[:, 3].min() for case in grid[method].values()) > 0.85


@pytest.mark.parametrize("method", ["smooth", "refined"])
@pytest.mark.parametrize("window_m", [10.0, 30.0])
def test_means_over_windows_scatter_as_stated(grid, method, window_m):
    """Within 25 %: 0.94 and 0.99 for `smooth`, 0.96 and 1.00 for `refined`, over 80 surveys."""
    means = [
        mean for case in grid[method].values() for check in case for mean in check.means if mean.window_m == window_m
    ]
    count = np.array([mean.count for mean in means])
    # Each survey counts alike: otherwise the worst-known terrain decides.
    ratio = np.sqrt(np.average([mean.ratio**2 for mean in means], weights=count))
    print(f"{method} {window_m:g} m: {ratio:.2f} over {count.sum()} windows of {len(means)} surveys")
    assert 0.75 < ratio < 1.25


LONG_M = 600.0


@pytest.fixture(scope="module")
def wide():
    """Means over windows of 100 m, six in each of some long and wide surveys."""
    found: dict[str, list[WindowMeans]] = {"smooth": [], "refined": []}
    for seed in SEEDS:
        for scene in ("hills", "ridges", "fractal"):
            for beam in (2.0, 4.0):
                long = {
                    "platform.start_m": [-LONG_M / 2 - 10, 0.0],
                    "platform.length_m": LONG_M,
                    "platform.altitude_m": 56.0,
                    "terrain.size_m": [LONG_M + 340, 400.0],
                    "terrain.seed": seed,
                    "radar.antenna.beamwidth_deg": beam,
                    "seed": seed,
                }
                for name, check in checked(scene, ("smooth", "refined"), long).items():
                    found[name] += [mean for mean in check.means if mean.window_m == 100]
    return found


@pytest.mark.parametrize("method", ["smooth", "refined"])
def test_means_over_windows_of_100_m_scatter_as_stated(wide, method):
    """Within 25 %: with four seeds 0.88 for `smooth` and 0.98 for `refined`, over 142 windows of 24 surveys."""
    count = np.array([mean.count for mean in wide[method]])
    ratio = np.sqrt(np.average([mean.ratio**2 for mean in wide[method]], weights=count))
    print(f"{method} 100 m: {ratio:.2f} over {count.sum()} windows of {len(count)} surveys")
    assert 0.75 < ratio < 1.25 if len(SEEDS) >= 4 else 0.5 < ratio < 1.6


def test_linear_maps_hold_within_eight_points():
    """56.0, 74.0, 92.6 and 96.2 % were measured."""
    found = [checked("hills", ("linear",), {"seed": s, "processing.ranging": "centroid"})["linear"] for s in (1, 2, 3)]
    assert np.abs(shares(found).mean(axis=0) - NOMINAL).max() < 0.08


def test_stepped_maps_are_not_stated_too_well():
    """93.1, 96.6, 98.8 and 98.9 % inside over 24 surveys of `buildings`, two minutes.

    The variance is that of a mixture: where a step may be, its 50 and 68 % intervals hold nearly all cells.
    """
    changes = {"processing.ranging": "centroid", "processing.echoes": "all"}
    found = [checked("buildings", ("stepped",), changes | {"seed": s})["stepped"] for s in range(1, 25)]
    print(f"stepped: {np.round(100 * shares(found).mean(axis=0), 1)} %")
    assert np.all(shares(found).mean(axis=0) > NOMINAL - 0.03)
    assert np.sqrt(np.mean([check.cells.rms_z**2 for check in found])) < 3


@pytest.mark.parametrize("beam", [2.0, 8.0])
@pytest.mark.parametrize("method", ["smooth", "refined"])
def test_rough_ground_is_not_stated_too_well(method, beam):
    """Hurst exponent 0.3, where no model is smooth enough: 90 % intervals hold 80 % at least."""
    rough = {"terrain.hurst": 0.3, "radar.antenna.beamwidth_deg": beam}
    found = [checked("fractal", (method,), rough | {"seed": s, "terrain.seed": s})[method] for s in (1, 2)]
    assert min(check.cells.coverage["90"] for check in found) > 0.8


@pytest.fixture(scope="module")
def creased(tmp_path_factory):
    """A steep DEM of 25 m posts, straight lines between them: flat facets and sharp creases."""
    posts = 60.0 * gaussian_filter(np.random.default_rng(3).standard_normal((25, 25)), 1.2)
    fine, coarse = np.arange(600.0), np.arange(25.0) * 25
    across = np.array([np.interp(fine, coarse, row) for row in posts])
    height = np.array([np.interp(fine, coarse, column) for column in across.T]).T
    path = tmp_path_factory.mktemp("creased") / "creased.tif"
    return write_heights(path, 300.0 + height, from_origin(WEST, NORTH, 1.0, 1.0))


@pytest.mark.parametrize("method", ["smooth", "refined", "linear"])
def test_creases_are_not_stated_too_well(method, creased):
    """90 % intervals hold 80 % at least: 86, 84 and 94 % were measured."""
    check = checked("own_dem", (method,), {"terrain.path": str(creased)})[method]
    assert check.cells.coverage["90"] > 0.8


@pytest.mark.parametrize("method", ["linear", "refined"])
def test_what_is_left_out_as_badly_known_is_what_errs(method, creased):
    """`dem.min_confidence_m` over a steep DEM of 25 m posts.

    `refined`: 0.097 m RMS over 99.9 % of the lit cells, 0.080 over the 83 % known to 0.08 m, 0.045 over the 34 % known
    to 0.05 m. `linear`: 0.144 m over 89 %, 0.122 over the 70 % known to 0.2 m, 0.076 over the 14 % known to 0.1 m.
    """
    bounds_m = {"refined": (0.08, 0.05), "linear": (0.2, 0.1)}[method]
    scenario = {"terrain.path": str(creased), "dem.method": method}
    found = [
        run(load_scenario("own_dem", scenario | {"dem.min_confidence_m": b})).lit_error for b in (100.0, *bounds_m)
    ]
    for wide, narrow in pairwise(found):
        said = f"{wide.rms_m:.3f} m over {wide.coverage:.1%}, {narrow.rms_m:.3f} over {narrow.coverage:.1%}"
        print(f"creased {method}: {said}")
        assert narrow.coverage < wide.coverage
        assert narrow.rms_m < 0.9 * wide.rms_m


def test_a_city_is_not_stated_too_well():
    """90 % intervals hold 90 % at least: 92.9, 95.7, 97.4, 97.8 % were measured, and an RMS of z of 1.1."""
    changes = {"processing.echoes": "all", "processing.ranging": "centroid"}
    check = checked("san_francisco", ("stepped",), changes)["stepped"]
    assert check.cells.coverage["90"] > 0.9
    assert check.cells.rms_z < 3
