"""Range-Doppler maps: places and powers of movers, migration, losses of windows."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.constants import speed_of_light

from beams import make_chirp
from sionna_radar.detection.range_doppler.frames import RangeDoppler
from sionna_radar.detection.range_doppler.movers import find_movers
from sionna_radar.foundation.errors import ScenarioError

FAST = make_chirp(bandwidth_hz=1e9, rate_hz=20e3, samples=256)


def frame(found: RangeDoppler, range_m: float, rate_mps: float, power: float = 1.0):
    """The beat of a mover, without approximations: its delay at every sample of every chirp."""
    chirp = found.chirp
    middle_s = (np.arange(found.chirps) - found.chirps // 2) / chirp.rate_hz
    time_s = chirp.sample_time_s[None]
    delay_s = 2 * (range_m + rate_mps * (middle_s[:, None] + time_s)) / speed_of_light
    swept = chirp.slope_hz_s * time_s * delay_s - chirp.slope_hz_s * delay_s**2 / 2
    phase = 2 * np.pi * chirp.direction * (chirp.carrier_hz * delay_s + swept)
    return np.sqrt(power) * (np.exp(1j * phase) if chirp.sampling == "iq" else np.sqrt(2) * np.cos(phase))


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
