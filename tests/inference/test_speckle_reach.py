"""How long speckle repeats: by geometry, against fields of scatterers drawn one by one."""

import numpy as np
import pytest

from sionna_radar.flight.frames import R_WORLD_NED, whisk_broom_from_antenna
from sionna_radar.flight.pulses import Pose
from sionna_radar.inference.echo.beam import beam_nodes
from sionna_radar.inference.echo.speckle import SpeckleMemory, repeats, speckle_reach
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.array_antenna import taylor_cut
from sionna_radar.radar.chirp import Chirp

CHIRP = Chirp(carrier_hz=77e9, bandwidth_hz=500e6, rate_hz=360.0, samples=1024)
TO_NED = R_WORLD_NED @ np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])


def flight(scan_deg, speed_mps=10.0):
    scan = np.deg2rad(scan_deg)
    time = np.arange(len(scan)) / CHIRP.rate_hz
    velocity = np.tile([speed_mps, 0.0, 0.0], (len(scan), 1))
    return Pose(
        position_m=np.array([0.0, 0.0, 50.0]) + time[:, None] * velocity,
        velocity_mps=velocity,
        R_world_antenna=TO_NED @ whisk_broom_from_antenna(np.pi / 4, scan),
    )


def nodes(beamwidth_deg):
    cut = taylor_cut(np.deg2rad(beamwidth_deg), -20.0)
    return beam_nodes(Antenna(cut, cut))


def drawn_correlations(pose, beam, draws=2000):
    """Correlations of the mean ranges' errors, and of the powers, of two pulses, over draws of the same scatterers.

    The scatterers are those that the beam lights, so many that their places add little to what the draws scatter.
    """
    rng = np.random.default_rng(6)
    middle = pose.position_m[0] - pose.position_m[0, 2] / pose.boresight[0, 2] * pose.boresight[0]
    place = np.column_stack([middle[:2] + rng.uniform(-18, 18, (50_000, 2)), np.zeros(50_000)])
    fields = []
    for pulse in range(2):
        away = place - pose.position_m[pulse]
        distance = np.linalg.norm(away, axis=1)
        gain = beam.two_way(away / distance[:, None] @ pose.R_world_antenna[pulse])
        amplitude = np.sqrt(gain * -away[:, 2] / distance) / distance**2
        cell = np.floor(distance / CHIRP.range_resolution_m).astype(int)
        fields.append((amplitude * np.exp(-4j * np.pi / CHIRP.wavelength_m * distance), cell))
    lit = np.any([np.abs(amplitude) > 1e-2 * np.abs(amplitude).max() for amplitude, _ in fields], axis=0)
    count, errors = int(lit.sum()), []
    drawn = rng.standard_normal((draws, 2 * count), dtype=np.float32).view(np.complex64)
    for amplitude, cell in fields:
        own = cell[lit] - cell[lit].min()
        onto = np.zeros((count, own.max() + 1), dtype=np.complex64)
        onto[np.arange(count), own] = amplitude[lit] / np.abs(amplitude).max()
        power, mean = np.abs(drawn @ onto) ** 2, np.sum(np.abs(onto) ** 2, axis=0)
        from_mean = np.arange(len(mean)) - mean @ np.arange(len(mean)) / mean.sum()
        errors.append((power @ from_mean, power.sum(axis=1)))
    return {of_power: np.corrcoef(*of_pulses)[0, 1] for of_power, of_pulses in enumerate(zip(*errors, strict=True))}


@pytest.mark.parametrize(
    ("beamwidth_deg", "scan_deg", "turn_deg", "within"),
    [(4.0, 0.0, 2.0, 0.12), (2.0, 30.0, 2.0, 0.08), (3.0, 45.0, 2.0, 0.08), (4.0, 30.0, 4.0, 0.08)],
)
def test_speckle_repeats_as_that_of_drawn_scatterers(beamwidth_deg, scan_deg, turn_deg, within):
    """Standard errors are 0.02 of the draws and 0.02 of the directions; where the beam climbs, 0.08 tells the two."""
    pose, beam = flight([scan_deg, scan_deg + turn_deg]), nodes(beamwidth_deg)
    range_m = -pose.position_m[:, 2] / pose.boresight[:, 2]
    drawn = drawn_correlations(pose, beam)
    # Errors one pulse apart are correlated by exp(-1 / reach^2).
    reach = {
        power: speckle_reach(np.arange(2), pose.rows, range_m, beam, CHIRP, SpeckleMemory(), of_power=power)[0]
        for power in (False, True)
    }
    stated = {power: np.exp(-1 / each**2) if each else 0.0 for power, each in reach.items()}
    for of_power in (False, True):
        assert stated[of_power] == pytest.approx(drawn[of_power], abs=within)
        if scan_deg:
            assert stated[not of_power] != pytest.approx(drawn[of_power], abs=within)


def test_powers_repeat_more_than_mean_ranges_where_the_beam_climbs():
    """The cells beyond the mean range of one echo lie before that of the next: a power has no such sign."""
    pose, beam = flight([30.0, 32.0]), nodes(2.0)
    range_m = -pose.position_m[:, 2] / pose.boresight[:, 2]
    reach = [
        speckle_reach(np.arange(2), pose.rows, range_m, beam, CHIRP, SpeckleMemory(), of_power=of_power)[0]
        for of_power in (False, True)
    ]
    assert reach[1] > 1.1 * reach[0]


def test_a_beam_that_stands_still_repeats_its_speckle_until_the_ground_forgets():
    pose, beam = flight(np.zeros(60), speed_mps=0.0), nodes(2.0)
    range_m = np.full(60, 70.7)
    still = speckle_reach(np.arange(60), pose.rows, range_m, beam, CHIRP, SpeckleMemory())
    assert still.min() > 30
    memory = SpeckleMemory(decorrelation_s=5 / CHIRP.rate_hz)
    moving = speckle_reach(np.arange(60), pose.rows, range_m, beam, CHIRP, memory)
    assert 2 < moving[0] < 6
    assert not speckle_reach(np.arange(60), pose.rows, range_m, beam, CHIRP, SpeckleMemory(decorrelation_s=0.0)).any()


def test_the_field_has_lost_all_but_a_part_in_e_after_its_time():
    power = SpeckleMemory(decorrelation_s=0.2).correlation(np.array([0.0, 0.2]))
    assert power == pytest.approx([1.0, np.exp(-2)])


def test_repeats_are_the_sum_of_correlations():
    lags = np.arange(-100, 101)
    for reach in (0.0, 0.7, 3.0, 12.0):
        expected = np.exp(-((lags / max(reach, 1e-9)) ** 2)).sum()
        assert repeats(np.array([reach, 12.0]))[0] == pytest.approx(expected, rel=1e-6)
