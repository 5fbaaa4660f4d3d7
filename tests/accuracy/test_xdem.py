"""Agreement with xDEM, a program that is not ours, on the same rasters: `pip install sionna-radar[compare]`."""

import numpy as np
import pytest

from sionna_radar.accuracy.breakdown import SLOPES_DEG, by_class, variogram
from sionna_radar.accuracy.checkpoints import slope_deg
from sionna_radar.accuracy.compare import summarise
from sionna_radar.foundation.raster import Grid, Raster
from surveys import hill

pytestmark = pytest.mark.filterwarnings("ignore")


@pytest.fixture(scope="module")
def xdem():
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return pytest.importorskip("xdem")


@pytest.fixture(scope="module")
def rasters() -> tuple[Raster, Raster]:
    grid = Grid(west_m=-60.0, south_m=-60.0, spacing_m=0.5, columns=240, rows=200)
    truth = Raster(grid=grid, height_m=4 * hill(grid.centres_m).reshape(grid.shape))
    rng = np.random.default_rng(4)
    error = rng.normal(0.07, 0.2, grid.shape) + 0.5 * rng.standard_t(3, grid.shape) * (truth.height_m > 5)
    error[50:70, 100:130] = np.nan
    return Raster(grid=grid, height_m=error), truth


def test_spread(xdem, rasters):
    from geoutils.stats import linear_error, nmad

    error, _ = rasters
    values = error.height_m[error.filled]
    stats = summarise(error, np.ones(error.grid.shape, dtype=bool))
    # Its factor is 1.4826 as well.
    assert stats.nmad_m == pytest.approx(float(nmad(values)), rel=1e-9)
    assert stats.nmad_m == pytest.approx(float(xdem.spatialstats.nmad(values)), rel=1e-9)
    assert stats.std_m == pytest.approx(float(np.nanstd(values)), rel=1e-12)
    # What it calls LE90 is the two-sided width.
    assert stats.p95_p5_m == pytest.approx(float(linear_error(values, 90)), rel=1e-9)
    assert stats.le90_m == pytest.approx(float(linear_error(np.concatenate([values, -values]), 90)) / 2, rel=1e-3)


def test_slopes(xdem, rasters):
    error, truth = rasters
    north_up = truth.height_m[::-1]
    theirs = np.asarray(xdem.terrain.slope(north_up, resolution=truth.grid.spacing_m, surface_fit="Horn"))[::-1]
    ours = slope_deg(truth)
    inner = np.isfinite(ours)
    np.testing.assert_allclose(ours[inner], theirs[inner], atol=1e-3)
    both = inner & error.filled
    classes = by_class(error.height_m[both], ours[both], SLOPES_DEG)
    binned = xdem.spatialstats.nd_binning(
        error.height_m[both],
        list_var=[theirs[both]],
        list_var_names=["slope"],
        list_var_bins=[np.array(SLOPES_DEG)],
        statistics=["count", np.nanstd, xdem.spatialstats.nmad],
    )
    filled = binned[binned["count"] > 0]
    assert [c.count for c in classes] == pytest.approx(filled["count"].tolist(), abs=3)
    assert [c.nmad_m for c in classes] == pytest.approx(filled["nmad"].tolist(), rel=0.02)
    assert [c.std_m for c in classes] == pytest.approx(filled["nanstd"].tolist(), rel=0.02)


def test_variogram(xdem, rasters):
    pytest.importorskip("skgstat", reason="xDEM's variograms need scikit-gstat, which needs an older SciPy than ours")
    from test_breakdown import exponential_field

    grid = Grid(west_m=0.0, south_m=0.0, spacing_m=1.0, columns=300, rows=300)
    error = Raster(grid=grid, height_m=exponential_field(300, 8.0, 0.3, 6))
    ours = variogram(error, np.ones(grid.shape, dtype=bool), seed=2)
    theirs = xdem.spatialstats.sample_empirical_variogram(
        error.height_m, gsd=1.0, subsample=400, n_variograms=8, estimator="matheron", random_state=1
    )
    # Its lags are the upper bounds of their bins.
    upper = theirs["lags"].to_numpy()
    lag = (upper + np.concatenate([[0.0], upper[:-1]])) / 2
    same = (lag > 2) & (lag < 60) & (theirs["count"] > 300)
    expected = np.interp(lag, [x.lag_m for x in ours.lags], [x.semivariance_m2 for x in ours.lags])
    np.testing.assert_allclose(theirs["exp"][same], expected[same], rtol=0.15)
