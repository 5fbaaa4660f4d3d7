"""The threshold estimator on Brown's echo of flat rough ground, drawn and flown with a radio altimeter."""

import numpy as np
import pytest

from flights import make_pulses
from sionna_radar import load_scenario, prepare
from sionna_radar.detection.build import build_detector
from sionna_radar.detection.echoes import Echoes
from sionna_radar.radar.build import build_antenna, build_chirp
from sionna_radar.scenario.processing import AverageTable, CfarTable, ProcessingTable
from sionna_radar.scenario.radar import RadarTable

HEIGHT_M, CHIRPS, PULSES, FINE = 100.0, 8, 120, 16
RADAR = RadarTable(preset="alt_4300")
PROCESSING = ProcessingTable(
    ranging="threshold",
    average=AverageTable(chirps=CHIRPS, mode="incoherent"),
    cfar=CfarTable(kind="CA"),
    volume_clutter="off",
    doppler_correction=False,
)
DETECTOR = build_detector(PROCESSING, build_chirp(RADAR), speckle_looks=CHIRPS)
STEP_M = DETECTOR.analyser.chirp.range_resolution_m / FINE
RANGE_M = HEIGHT_M + (np.arange(1500) + 0.5) * STEP_M


def brown() -> np.ndarray:
    """Impulse response of a flat surface at nadir for a Gaussian beam (Brown 1977, eq. 9), on RANGE_M."""
    width = 2 / np.log(2) * np.sin(RADAR.antenna.beamwidths_rad[0] / 2) ** 2
    return np.exp(-8 * (RANGE_M - HEIGHT_M) / (width * HEIGHT_M))


def surface_integral() -> np.ndarray:
    """The same without small angles: rings of ground of sigma0 = gamma cos through the antenna's own pattern."""
    cosine = HEIGHT_M / RANGE_M
    turn, incidence = np.meshgrid(np.deg2rad(np.arange(0, 360, 5)), np.arccos(cosine))
    across = np.sin(incidence)
    direction = np.stack([np.cos(incidence), across * np.cos(turn), across * np.sin(turn)], axis=-1)
    gain = build_antenna(RADAR.antenna).gain(direction.reshape(-1, 3)).reshape(turn.shape)
    return np.mean(gain**2, axis=1) * cosine / RANGE_M**3


def crossing_m(impulse_response: np.ndarray) -> float:
    """Range at which the mean echo, through the window, first reaches half of its amplitude."""
    mean = np.convolve(impulse_response, DETECTOR.analyser.response(6 * FINE, FINE))
    range_m = RANGE_M[0] + (np.arange(len(mean)) - 6 * FINE) * STEP_M
    speckle = (1 + 2 / CHIRPS) * (1 + 3 / CHIRPS)
    level = 0.5 * np.sqrt(speckle * np.sum(mean**4) / np.sum(mean**2))
    after = int(np.argmax(mean > level))
    return float(np.interp(level, mean[after - 1 : after + 1], range_m[after - 1 : after + 1]))


def assert_read(echoes: Echoes, expected_m: float) -> None:
    """Every pulse is read, without bias but for what speckle does to the crossing of a curved edge, and honestly."""
    assert len(echoes.range_m) == PULSES
    assert np.mean(echoes.range_m) == pytest.approx(expected_m, abs=0.1)
    stated = np.sqrt(np.mean(echoes.range_sigma_m**2))
    assert 0.4 < np.std(echoes.range_m) / stated < 1.0


def test_a_drawn_echo_is_read_where_its_mean_crosses_the_level():
    rng, chirp = np.random.default_rng(3), DETECTOR.analyser.chirp
    cycles = np.outer(RANGE_M / chirp.range_resolution_m, np.arange(chirp.samples) / chirp.samples)
    speckle = rng.standard_normal((CHIRPS * PULSES, len(RANGE_M), 2)) @ np.array([1.0, 1j])
    beat = ((speckle * np.sqrt(brown())) @ np.exp(2j * np.pi * cycles)).real
    beat += 1e-3 * rng.standard_normal(beat.shape)
    pulses = make_pulses(PULSES)
    assert_read(DETECTOR.detect(beat, pulses.index, pulses.measured), crossing_m(brown()))


def test_the_simulated_altimeter_reads_the_flat_surface_integral():
    speed_mps = 0.01  # slow, so that Doppler shifts do not widen the edge
    scenario = load_scenario(
        "hills",
        {
            "terrain": {"kind": "flat", "size_m": [800.0, 800.0]},
            "platform.speed_mps": speed_mps,
            "platform.altitude_m": HEIGHT_M,
            "platform.length_m": speed_mps * CHIRPS * PULSES / RADAR.chirp_rate_hz,
            "radar": {"preset": "alt_4300"},
            "tracing.speckle": "per_pulse",
            "processing": PROCESSING.model_dump(exclude_none=True),
            "dem.method": "linear",
        },
    )
    expected_m = crossing_m(surface_integral())
    assert expected_m == pytest.approx(crossing_m(brown()), abs=0.05)
    assert_read(prepare(scenario).echoes(np.arange(PULSES)), expected_m)
