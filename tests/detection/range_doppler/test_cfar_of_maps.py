"""False alarms of detectors of range-Doppler maps, in noise that windows correlate."""

from dataclasses import replace

import numpy as np
import pytest

from beams import make_chirp
from sionna_radar.detection.range_doppler.cfar import ClutterMap, RingCfar
from sionna_radar.detection.range_doppler.frames import RangeDoppler
from sionna_radar.foundation.errors import ScenarioError

FRAMES = RangeDoppler(chirp=replace(make_chirp(samples=256, rate_hz=20e3), sampling="iq"), chirps=128)
WHITE = (np.array([1.0]), np.array([1.0]))


def noise_map(rng) -> np.ndarray:
    return FRAMES.map(rng.standard_normal((128, 256)) + 1j * rng.standard_normal((128, 256))).power


@pytest.mark.parametrize("kind", ["CA", "OS"])
@pytest.mark.parametrize("wanted", [1e-2, 1e-3])
def test_noise_is_detected_as_often_as_specified(kind, wanted):
    cfar = RingCfar(
        kind=kind,
        guard=(2, 2),
        training=(4, 4),
        false_alarm_probability=wanted,
        correlation=FRAMES.noise_correlation(12),
    )
    rng = np.random.default_rng(5)
    found = [cfar.detected(noise_map(rng))[:, 6:-6] for _ in range(12)]
    rate = np.mean(found)
    # Of cells correlated with their neighbours some four count as one.
    scatter = np.sqrt(4 * wanted / np.size(found))
    assert rate == pytest.approx(wanted, abs=4 * scatter)
    assert not cfar.detected(noise_map(rng))[:, [0, 5, -1, -6]].any()  # the ring does not fit


def test_the_noise_is_that_of_the_map():
    for kind in ("CA", "OS"):
        cfar = RingCfar(
            kind=kind,
            guard=(2, 2),
            training=(4, 4),
            false_alarm_probability=1e-4,
            correlation=FRAMES.noise_correlation(12),
        )
        power = noise_map(np.random.default_rng(6))
        assert np.mean(cfar.noise(power)[:, 6:-6]) == pytest.approx(np.mean(power), rel=0.03)


def test_independent_cells_have_the_closed_form():
    cfar = RingCfar(guard=(1, 1), training=(2, 3), false_alarm_probability=1e-5, correlation=WHITE)
    assert cfar.cells == 7 * 9 - 9
    assert (1 + cfar.factor / cfar.cells) ** -cfar.cells == pytest.approx(1e-5, rel=1e-8)


def test_the_ring_closes_over_the_ends_of_range_rate():
    cfar = RingCfar(guard=(1, 1), training=(2, 2), false_alarm_probability=1e-4, correlation=WHITE)
    power = np.random.default_rng(7).exponential(size=(32, 40))
    turned = np.roll(cfar.noise(power), 5, axis=0)
    np.testing.assert_allclose(cfar.noise(np.roll(power, 5, axis=0)), turned, rtol=1e-12)
    row, bin_ = 3, 20
    ring = power[np.ix_(np.arange(row - 3, row + 4) % 32, np.arange(bin_ - 3, bin_ + 4))].sum()
    ring -= power[row - 1 : row + 2, bin_ - 1 : bin_ + 2].sum()
    assert cfar.noise(power)[row, bin_] == pytest.approx(ring / cfar.cells)


def test_an_order_statistic_bears_a_second_target():
    power = np.ones((32, 40))
    power[10, 20], power[10, 23] = 40.0, 4000.0
    mean, ordered = (
        RingCfar(kind=kind, guard=(1, 1), training=(2, 2), false_alarm_probability=1e-4, correlation=WHITE)
        for kind in ("CA", "OS")
    )
    assert not mean.detected(power)[10, 20]
    assert ordered.detected(power)[10, 20]


@pytest.mark.parametrize("maps", [2, 5, 60])
def test_a_clutter_map_is_right_from_the_second_map_on(maps):
    """Over clutter whose mean power differs from cell to cell by orders of magnitude."""
    rng = np.random.default_rng(8)
    mean = 10 ** rng.uniform(-3, 3, (200, 400))
    clutter = ClutterMap(weight=0.2, false_alarm_probability=1e-2)
    for _ in range(maps):
        found = clutter.detected(mean * rng.exponential(size=mean.shape))
    assert found.mean() == pytest.approx(1e-2, abs=4 * np.sqrt(1e-2 / mean.size))


def test_what_cannot_be_is_refused():
    usual = {"guard": (2, 2), "training": (4, 4), "false_alarm_probability": 1e-4, "correlation": WHITE}
    with pytest.raises(ScenarioError, match="guard: 1 cells of rate; the window needs at least 2"):
        RingCfar(**usual | {"guard": (1, 2), "correlation": FRAMES.noise_correlation(8)})
    with pytest.raises(ScenarioError, match="training"):
        RingCfar(**usual | {"training": (0, 0)})
    with pytest.raises(ScenarioError, match="does not fit a map"):
        RingCfar(**usual | {"training": (9, 9)}).detected(np.ones((16, 64)))
    with pytest.raises(ScenarioError, match="weight: 1 is no share"):
        ClutterMap(weight=1.0, false_alarm_probability=1e-4)
