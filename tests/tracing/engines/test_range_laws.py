"""How the power falls with range: 6, 9 and 12 dB per doubling, each where its law holds.

A point: P ~ 1 / r^4. A plane that fills the beam: the lit area grows with r^2, so P ~ 1 / r^2. One range cell of a
plane, the beam limited across and the cell along: the area is (r times the beam's width) times the cell's fixed
length, so P ~ 1 / r^3.
"""

import numpy as np
import pytest
from scipy.constants import speed_of_light

from beams import make_antenna, make_chirp
from flights import make_pulses
from sionna_radar.tracing.engines.beam.beam import BeamEngine

DOUBLING_DB = 10 * np.log10(2)


@pytest.fixture(scope="module")
def total_and_cell(plane):
    """Mean power of a pulse, in all and within 2 m of range about the boresight, from 40 m and from 80 m up."""
    engine = BeamEngine(plane, make_antenna(2.0, 20.0), make_chirp(), 1, 8192, 0.01)
    powers = {}
    for height in (40.0, 80.0):
        pulses = make_pulses(60, incidence_deg=45.0, position_m=(0.0, 0.0, height))
        paths = engine.trace(pulses)
        power = np.abs(paths.gain) ** 2
        middle = height / np.cos(np.deg2rad(45.0))
        in_cell = np.abs(speed_of_light * paths.delay_s / 2 - middle) < 1.0
        powers[height] = power.sum() / len(pulses), power[in_cell].sum() / len(pulses)
    return powers


def fall_db(low: float, high: float) -> float:
    return float(10 * np.log10(low / high))


def test_a_plane_that_fills_the_beam_falls_6_db(total_and_cell):
    assert fall_db(total_and_cell[40.0][0], total_and_cell[80.0][0]) == pytest.approx(2 * DOUBLING_DB, abs=0.02)


def test_a_range_cell_of_a_plane_falls_9_db(total_and_cell):
    assert fall_db(total_and_cell[40.0][1], total_and_cell[80.0][1]) == pytest.approx(3 * DOUBLING_DB, abs=0.1)
