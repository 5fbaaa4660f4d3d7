"""The mean echo of flat rough ground under a vertical beam: Brown's waveform, and the integral over rings of ground."""

import numpy as np
import pytest
from scipy.constants import speed_of_light

from beams import make_chirp
from flights import make_pulses
from sionna_radar.radar.antenna import antenna_of
from sionna_radar.radar.pattern import SphericalPattern
from sionna_radar.surfaces.backscatter import TableBackscatter
from sionna_radar.tracing.engines.beam.beam import BeamEngine
from worlds import plane_of

HEIGHT_M, SIGMA0, PULSES = 50.0, 0.1, 2000
EVEN = TableBackscatter(incidence_rad=(0.0, 1.5), sigma0_db=(-10.0, -10.0))
# Delay after the nearest point in units of the decay of Brown's echo, in steps.
EDGES = np.linspace(0.0, 4.0, 17)


@pytest.mark.parametrize(
    ("beamwidth_deg", "brown_within"),
    # SMRT 1.7 has the same waveform (`Brown1977.PFS`). At 40 deg its small angles alone are off by 2.4 % of the peak.
    [(2.0, 0.01), (8.0, 0.01), (17.0, 0.01), (40.0, 0.03)],
)
def test_the_echo_of_a_wide_beam_over_flat_ground(beamwidth_deg, brown_within):
    # The one-way gain exp(-2 sin^2 / width) of Brown (1977), eq. 4.
    width = 2 / np.log(2) * np.sin(np.deg2rad(beamwidth_deg) / 2) ** 2

    def voltage(direction: np.ndarray) -> np.ndarray:
        across = direction[:, 1] ** 2 + direction[:, 2] ** 2
        return np.where(direction[:, 0] > 0, np.exp(-across / width), 0.0)

    antenna, chirp = antenna_of(SphericalPattern.of(voltage, np.deg2rad(beamwidth_deg / 20))), make_chirp()
    paths = BeamEngine(plane_of(EVEN), antenna, chirp, 1, 512, 0.05).trace(make_pulses(PULSES))
    decay_m = width * HEIGHT_M / 8
    delay = (paths.delay_s * speed_of_light / 2 - HEIGHT_M) / decay_m
    power = np.histogram(delay, EDGES, weights=np.abs(paths.gain.astype(complex)) ** 2)[0] / PULSES / np.diff(EDGES)
    level = chirp.wavelength_m**2 * antenna.peak_gain**2 * SIGMA0 / (4 * np.pi) ** 3 * 2 * np.pi
    # Rings of ground of the area 2 pi r dr at the range r: G^2 sigma0 / r^4 of each.
    fine = (np.arange(len(EDGES[1:]) * 100) + 0.5) * EDGES[-1] / len(EDGES[1:]) / 100
    range_m = HEIGHT_M + decay_m * fine
    rings = np.exp(-4 / width * (1 - (HEIGHT_M / range_m) ** 2)) * level / range_m**3 * decay_m
    rings, brown = (
        each.reshape(-1, 100).mean(axis=1) for each in (rings, np.exp(-fine) * level * decay_m / HEIGHT_M**3)
    )
    np.testing.assert_allclose(power / rings[0], rings / rings[0], atol=0.01)
    np.testing.assert_allclose(power / power[0], brown / brown[0], atol=brown_within)
