"""A moving radar reads ranges wrong by its Doppler shift, and the correction puts them right."""

from dataclasses import replace

import numpy as np
import pytest

from beams import make_chirp
from direct_receiver import points_at
from flights import make_pulses
from sionna_radar.detection.build import build_detector
from sionna_radar.flight.pulses import Pulses
from sionna_radar.scenario.processing import ProcessingTable
from sionna_radar.signal.beat import synthesise
from sionna_radar.signal.receiver import add_noise

C = 299_792_458.0
PULSES = 40


@pytest.fixture(scope="module")
def flight() -> Pulses:
    """14 m/s north, the beam 30 deg from the velocity (60 deg from nadir), over 40 places of a range cell."""
    return make_pulses(PULSES, incidence_deg=60.0, velocity_mps=(0.0, 14.0, 0.0))


def ranges_of(pulses, chirp, processing, range_m):
    rate_mps = pulses.true.boresight_range_rate_mps
    paths = points_at(range_m, np.exp(1j * np.linspace(0, 50, PULSES)), rate_mps, pulses.index)
    beat = add_noise(synthesise(paths, pulses, chirp), 1e-3, 1, pulses.index)
    echoes = build_detector(processing, chirp).detect(beat, pulses.index, pulses.measured)
    np.testing.assert_array_equal(echoes.pulse, pulses.index)
    return echoes.range_m


@pytest.mark.parametrize("ranging", ["peak", "centroid"])
@pytest.mark.parametrize("sampling", ["real", "iq"])
@pytest.mark.parametrize("sweep", ["up", "down"])
def test_14_mps_at_30_deg_shifts_5_m_and_is_corrected(flight, sweep, sampling, ranging):
    chirp = make_chirp(sweep=sweep, sampling=sampling)
    range_m = np.linspace(100, 100.6, PULSES)
    raw, corrected = (
        ranges_of(flight, chirp, ProcessingTable(ranging=ranging, doppler_correction=on), range_m) - range_m
        for on in (False, True)
    )
    short = -1 if sweep == "up" else 1  # the ground ahead approaches
    assert raw.mean() == pytest.approx(short * 5.19, abs=0.02)
    # 2 f0 v / c = 6.2 kHz of a beat of 1200 Hz per metre.
    assert abs(raw.mean()) * 2 * 500e6 * 360 / C == pytest.approx(6228, abs=25)
    assert abs(corrected.mean()) < 0.005
    assert np.abs(corrected).max() < 0.02


@pytest.mark.parametrize("error_mps", [0.05, -0.05])
def test_a_velocity_error_of_5_cm_per_second_costs_2_cm(error_mps):
    pulses = make_pulses(PULSES, velocity_mps=(0.0, 0.0, -5.0))  # descending on a target straight below
    wrong = pulses.measured.velocity_mps + np.array([0.0, 0.0, error_mps])
    pulses = replace(pulses, measured=replace(pulses.measured, velocity_mps=wrong))
    range_m = np.linspace(50, 50.6, PULSES)
    bias = (ranges_of(pulses, make_chirp(), ProcessingTable(), range_m) - range_m).mean()
    assert bias == pytest.approx(-np.sign(error_mps) * 0.021, abs=0.004)
