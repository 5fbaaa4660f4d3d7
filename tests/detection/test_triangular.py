"""Triangular sweep: range and velocity from one up/down pair, against the sawtooth that is told the velocity."""

import numpy as np
import pytest

from beams import make_chirp
from direct_receiver import points_at
from flights import make_pulses
from sionna_radar.detection.build import build_detector
from sionna_radar.detection.detector import pair_sweeps
from sionna_radar.detection.echoes import Echoes
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.radar.build import build_chirp, build_sweeps
from sionna_radar.scenario import parse_scenario
from sionna_radar.scenario.processing import ProcessingTable
from sionna_radar.scenario.radar import RadarTable
from sionna_radar.signal.beat import synthesise
from sionna_radar.signal.receiver import add_noise
from sionna_radar.tracing.paths import Paths

PULSES = 40
RANGES_M = np.linspace(100, 100.6, PULSES)


def radar_of(sweep: str, sampling: str = "real") -> RadarTable:
    return RadarTable(snr_db=30.0, sweep=sweep, sampling=sampling)


def paths_of(pulses, range_rate_mps) -> Paths:
    return points_at(RANGES_M, np.exp(1j * np.linspace(0, 50, PULSES)), range_rate_mps, pulses.index)


def pairs_of(pulses, range_rate_mps, sampling="real"):
    up, down = build_sweeps(radar_of("triangular", sampling))
    detector = build_detector(ProcessingTable(), up)
    paths = paths_of(pulses, range_rate_mps)
    echoes = []
    for number, sweep in enumerate((up, down)):
        beat = add_noise(synthesise(paths, pulses, sweep), 1e-3, number, pulses.index)
        echoes.append(detector.uncorrected(detector.spectra(beat), pulses.index))
    return pair_sweeps(*echoes, up)


def sawtooth_of(pulses, range_rate_mps):
    chirp = build_chirp(radar_of("up"))
    beat = add_noise(synthesise(paths_of(pulses, range_rate_mps), pulses, chirp), 1e-3, 1, pulses.index)
    return build_detector(ProcessingTable(), chirp).detect(beat, pulses.index, pulses.measured)


@pytest.fixture(scope="module")
def flight():
    """14 m/s, the beam 30 deg from the velocity."""
    return make_pulses(PULSES, incidence_deg=60.0, velocity_mps=(0.0, 14.0, 0.0))


def test_a_period_holds_both_halves():
    up, down = build_sweeps(radar_of("triangular"))
    assert (up.direction, down.direction) == (1, -1)
    assert up.duration_s == down.duration_s == 1 / 720
    assert (up.centre_s, down.centre_s) == (-1 / 1440, 1 / 1440)
    assert up.max_range_m == build_chirp(radar_of("up")).max_range_m
    assert build_chirp(radar_of("triangular")) == up


@pytest.mark.parametrize("sampling", ["real", "iq"])
def test_14_mps_at_30_deg_without_knowing_it(flight, sampling):
    rate = flight.true.boresight_range_rate_mps
    np.testing.assert_allclose(rate, -14 * np.cos(np.pi / 6))
    pairs = pairs_of(flight, rate, sampling)
    np.testing.assert_array_equal(pairs.echoes.pulse, flight.index)
    assert abs((pairs.echoes.range_m - RANGES_M).mean()) < 0.005
    assert np.abs(pairs.echoes.range_m - RANGES_M).max() < 0.02
    assert abs((pairs.range_rate_mps - rate).mean()) < 0.02
    assert (pairs.range_rate_mps - rate).std() < 0.1
    # The sawtooth is as good when it is told the velocity.
    assert np.abs(sawtooth_of(flight, rate).range_m - RANGES_M).max() < 0.02


@pytest.mark.parametrize("own_mps", [5.0, -8.0])
def test_a_moving_target_misleads_the_sawtooth_alone(flight, own_mps):
    """Its own motion adds f0 v / (B fm), 0.43 m for each m/s, to the sawtooth; the pair tells it."""
    rate = flight.true.boresight_range_rate_mps + own_mps
    off = (sawtooth_of(flight, rate).range_m - RANGES_M).mean()
    assert off == pytest.approx(77e9 * own_mps / (500e6 * 360), abs=0.02)
    pairs = pairs_of(flight, rate)
    assert abs((pairs.echoes.range_m - RANGES_M).mean()) < 0.005
    assert (pairs.range_rate_mps - flight.true.boresight_range_rate_mps).mean() == pytest.approx(own_mps, abs=0.02)


def test_a_pulse_without_both_echoes_is_dropped():
    def echoes(*pulses: int) -> Echoes:
        n = len(pulses)
        return Echoes(
            pulse=np.array(pulses, dtype=int), number=np.zeros(n, dtype=int), range_m=np.full(n, 50.0),
            range_sigma_m=np.full(n, 0.1), power=np.ones(n), echo_snr_db=np.full(n, 20.0),
        )  # fmt: skip

    pairs = pair_sweeps(echoes(1, 2, 5), echoes(2, 3, 5), make_chirp())
    np.testing.assert_array_equal(pairs.echoes.pulse, [2, 5])
    np.testing.assert_allclose(pairs.echoes.echo_snr_db, 20.0)
    assert len(pair_sweeps(echoes(), echoes(1), make_chirp()).echoes) == 0


def test_a_pair_behind_rain_keeps_what_its_pulses_share():
    """The mean of two independent halves has half the root of the sum of their squares."""

    def half(shared_m: float, reach: float) -> Echoes:
        return Echoes(
            pulse=np.arange(3), number=np.zeros(3, dtype=int), range_m=np.full(3, 50.0), range_sigma_m=np.full(3, 0.1),
            power=np.ones(3), echo_snr_db=np.full(3, 20.0), reach=np.full(3, reach),
            shared_sigma_m=np.full(3, shared_m),
        )  # fmt: skip

    echoes = pair_sweeps(half(0.3, 2.0), half(0.4, 4.0), make_chirp()).echoes
    np.testing.assert_allclose(echoes.shared_sigma_m, 0.25)
    np.testing.assert_allclose(echoes.reach, 3.0)


def test_all_echoes_cannot_be_paired():
    data = {
        "terrain": {"kind": "flat"},
        "platform": {"altitude_m": 50.0, "speed_mps": 10.0},
        "radar": {"snr_db": 30.0, "sweep": "triangular"},
        "processing": {"echoes": "all"},
    }
    with pytest.raises(ScenarioError, match=r"processing\.echoes"):
        parse_scenario(data)
