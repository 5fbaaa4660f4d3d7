"""Range-Doppler maps: movers, migration, losses of windows, and false alarms of their detectors."""

from dataclasses import replace

import numpy as np
import pytest

from beams import make_chirp
from plain_beats import mover_beats
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.studies.range_doppler.cfar import ClutterMap, RingCfar
from sionna_radar.studies.range_doppler.frames import RangeDoppler
from sionna_radar.studies.range_doppler.movers import find_movers

FAST = make_chirp(bandwidth_hz=1e9, rate_hz=20e3, samples=256)


def frame(found: RangeDoppler, range_m: float, rate_mps: float, power: float = 1.0):
    middle_s = (np.arange(found.chirps) - found.chirps // 2) / found.chirp.rate_hz
    return mover_beats(found.chirp, middle_s, range_m, rate_mps, power)


@pytest.mark.parametrize("sampling", ["real", "iq"])
@pytest.mark.parametrize("sweep", ["up", "down"])
@pytest.mark.parametrize("rate_mps", [-17.03, 0.0, 3.21])
def test_a_mover_has_its_range_its_rate_and_its_power(sampling, sweep, rate_mps):
    found = RangeDoppler(chirp=replace(FAST, sampling=sampling, sweep=sweep), chirps=128, zero_padding=2)
    made = found.map(frame(found, 11.27, rate_mps, power=4.0))
    movers = find_movers(made, made.power > 1.0)
    assert len(movers) == 1
    assert movers.range_rate_mps[0] == pytest.approx(rate_mps, abs=0.01 * found.rate_cell_mps)
    assert movers.range_m[0] == pytest.approx(11.27, abs=0.01 * found.chirp.range_resolution_m)
    assert movers.power[0] == pytest.approx(4.0, rel=0.01)


@pytest.mark.parametrize("sweep", ["up", "down"])
@pytest.mark.parametrize("rate_mps", [-19.43, 19.43])
def test_range_rates_lie_within_their_ends(sweep, rate_mps):
    """A tenth of a cell before an end the strongest bin may be that of the other one."""
    # Coarse cells: a map takes out the migration of the other end's rate.
    found = RangeDoppler(chirp=replace(FAST, sweep=sweep, bandwidth_hz=1e8), chirps=128, zero_padding=2)
    made = found.map(frame(found, 11.27, rate_mps))
    movers = find_movers(made, made.power > 0.25)
    assert movers.range_rate_mps[0] == pytest.approx(rate_mps, abs=0.05 * found.rate_cell_mps)
    assert movers.range_m[0] == pytest.approx(11.27, abs=0.1 * found.chirp.range_resolution_m)


def test_a_mover_that_migrates_stays_in_its_cell():
    """Over 512 chirps it moves 3 cells, which would spread its echo over as many."""
    found = RangeDoppler(chirp=replace(FAST, sampling="iq"), chirps=512)
    moved = 18.0 * 512 / FAST.rate_hz / FAST.range_resolution_m
    assert moved > 3
    movers = find_movers(made := found.map(frame(found, 11.0, 18.0)), made.power > 0.2)
    assert len(movers) == 1
    assert movers.power[0] == pytest.approx(1.0, rel=0.05)
    assert movers.range_rate_mps[0] == pytest.approx(18.0, abs=0.05 * found.rate_cell_mps)


def test_the_transform_is_the_plain_sum():
    found = RangeDoppler(chirp=replace(FAST, samples=32, sampling="iq"), chirps=12, zero_padding=2)
    rng = np.random.default_rng(1)
    beat = rng.standard_normal((12, 32)) + 1j * rng.standard_normal((12, 32))
    scale = 1 + found.chirp.slope_hz_s * found.chirp.sample_time_s / found.chirp.carrier_hz
    k, m, n = np.arange(24) - 12, np.arange(12) - 6, np.arange(32)
    weighed = found.rate_weights[:, None] * beat * found.range_weights
    slow = np.einsum("kms,ms->ks", np.exp(-2j * np.pi * k[:, None, None] * m[:, None] * scale / 24), weighed)
    plain = slow @ np.exp(-2j * np.pi * np.outer(n, np.arange(64)) / 64)
    np.testing.assert_allclose(found.amplitude(beat), plain, atol=1e-12)


@pytest.mark.parametrize(("name", "noise_db", "straddling_db"), [("boxcar", 0.0, 3.92), ("hann", 1.76, 1.42)])
def test_windows_lose_what_is_known_of_them(name, noise_db, straddling_db):
    """Harris 1978, table 1, in each direction."""
    found = RangeDoppler(chirp=FAST, chirps=128, range_window=name, rate_window=name)
    assert found.noise_loss_db == pytest.approx(2 * noise_db, abs=0.01)
    assert found.straddling_loss_db == pytest.approx(2 * straddling_db, abs=0.02)
    # The noise of a map is that of a sample over all samples of the frame, raised by the loss.
    noise = np.random.default_rng(2).standard_normal((128, 256))
    floor = np.mean(found.map(noise).power[:, 10:-10])
    assert 10 * np.log10(floor * 128 * 256) == pytest.approx(found.noise_loss_db + 3.01, abs=0.1)


def test_too_few_chirps_and_other_frames_are_refused():
    with pytest.raises(ScenarioError, match="chirps: 2 do not resolve"):
        RangeDoppler(chirp=FAST, chirps=2)
    with pytest.raises(ValueError, match=r"8 chirps of 256 samples, not \(9, 256\)"):
        RangeDoppler(chirp=FAST, chirps=8).map(np.zeros((9, 256)))


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


def test_independent_cells_have_the_closed_form():
    cfar = RingCfar(guard=(1, 1), training=(2, 3), false_alarm_probability=1e-5, correlation=WHITE)
    assert cfar.cells == 7 * 9 - 9
    assert (1 + cfar.factor / cfar.cells) ** -cfar.cells == pytest.approx(1e-5, rel=1e-8)


def test_the_ring_closes_over_the_ends_of_range_rate():
    cfar = RingCfar(guard=(1, 1), training=(2, 2), false_alarm_probability=0.3, correlation=WHITE)
    power = np.random.default_rng(7).exponential(size=(32, 40))
    detected = cfar.detected(power)
    assert 0.1 < detected[:, 3:-3].mean() < 0.5
    np.testing.assert_array_equal(cfar.detected(np.roll(power, 5, axis=0)), np.roll(detected, 5, axis=0))
    row, bin_ = 2, 20  # the ring reaches over row 0
    ring = power[np.ix_(np.arange(row - 3, row + 4) % 32, np.arange(bin_ - 3, bin_ + 4))].sum()
    ring -= power[row - 1 : row + 2, bin_ - 1 : bin_ + 2].sum()
    for factor, expected in ((0.999, False), (1.001, True)):
        power[row, bin_] = factor * cfar.factor * ring / cfar.cells
        assert cfar.detected(power)[row, bin_] == expected


def test_an_order_statistic_bears_a_second_target():
    power = np.ones((32, 40))
    power[10, 20], power[10, 23] = 40.0, 4000.0
    mean, ordered = (
        RingCfar(kind=kind, guard=(1, 1), training=(2, 2), false_alarm_probability=1e-4, correlation=WHITE)
        for kind in ("CA", "OS")
    )
    assert not mean.detected(power)[10, 20]
    assert ordered.detected(power)[10, 20]


@pytest.mark.parametrize("looks", [1, 2])
@pytest.mark.parametrize("maps", [2, 5, 60])
def test_a_clutter_map_is_right_from_the_second_map_on(maps, looks):
    """Over clutter whose mean power differs from cell to cell by orders of magnitude."""
    rng = np.random.default_rng(8)
    mean = 10 ** rng.uniform(-3, 3, (200, 400))
    clutter = ClutterMap(weight=0.2, false_alarm_probability=1e-2, looks=looks)
    for _ in range(maps):
        found = clutter.detected(mean * rng.gamma(looks, size=mean.shape))
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
