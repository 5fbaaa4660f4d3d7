"""A small survey of hills, and a radar that is stepped along it."""

import numpy as np
import pytest

from sionna_radar.flight.frames import body_motion
from sionna_radar.scenario import load_scenario
from sionna_radar.survey.chain import run

LENGTH = {"platform.length_m": 10.0, "tracing.paths_per_pulse": 64}


@pytest.fixture(scope="session")
def hills():
    return run(load_scenario("hills", LENGTH))


@pytest.fixture(scope="session")
def step_along():
    """A function that steps a radar along its planned flight, so many poses at once, and returns the frames."""

    def step(radar, time_s, at_once=1):
        frames = []
        for rows in np.split(time_s, range(at_once, len(time_s), at_once)):
            motion = body_motion(radar.prepared.flight.trajectory, rows)
            frames.append(
                radar.step(rows, motion.position_m, motion.euler_rad, motion.velocity_mps, turn_rad_s=motion.turn_rad_s)
            )
        return [*frames, radar.flush()]

    return step
