"""Focusing ground that bears persistent scatterers: speckle and contrast."""

import numpy as np
import pytest
from scipy.stats import kstest

from side_looking import make_flight
from sionna_radar.imaging.aperture import Aperture, ground_pixels
from sionna_radar.imaging.sar import focus
from sionna_radar.imaging.strip import azimuth_resolution_m, ground_range_resolution_m
from sionna_radar.scene.model import Scene, Surface
from sionna_radar.signal.beat import synthesise
from sionna_radar.surfaces.backscatter import ConstantGammaBackscatter
from sionna_radar.tracing.engines.persistent.persistent import PersistentEngine

NEAR_M, FAR_M, HALF_M = 26.0, 30.5, 1.5
BRIGHT_DB = 3.0


def patch(south_m: float, north_m: float, material: str) -> Surface:
    east, north = np.array([NEAR_M, FAR_M, FAR_M, NEAR_M]), np.array([south_m, south_m, north_m, north_m])
    vertices = np.column_stack([east, north, np.zeros(4)])
    return Surface(name=material, vertices_m=vertices, faces=np.array([[0, 1, 2], [0, 2, 3]]), material=material)


@pytest.fixture(scope="module")
def field():
    """Independent pixels of a focused field whose northern half scatters 3 dB more: power, and place along."""
    flight = make_flight(rate_hz=1000.0, bandwidth_hz=1e9, samples=384)
    scene = Scene(
        surfaces=(patch(-HALF_M, 0.0, "dark"), patch(0.0, HALF_M, "bright")),
        materials={
            "dark": ConstantGammaBackscatter(0.01),
            "bright": ConstantGammaBackscatter(0.01 * 10 ** (BRIGHT_DB / 10)),
        },
        targets=(),
        ground_material="dark",
        georeference=None,
    )
    pulses = flight.pulses(4.0, every=2)
    engine = PersistentEngine(scene, flight.antenna, flight.chirp, seed=3, density=400.0)
    beats = synthesise(engine.trace(pulses), pulses, flight.chirp)
    aperture = Aperture(width_rad=np.deg2rad(4.0), azimuth=flight.antenna.azimuth)
    # A spacing of 1.3 widths leaves neighbours nearly independent.
    along = 1.3 * azimuth_resolution_m(aperture, flight.chirp.wavelength_m)
    across = 1.3 * ground_range_resolution_m(flight.chirp, "hann", np.pi / 4)
    grid = ground_pixels(
        pulses.measured,
        "right",
        0.0,
        4.0 + np.arange(-HALF_M - 0.3, HALF_M + 0.3, along),
        np.arange(NEAR_M + 2 * across, FAR_M - 2 * across, across),
    )
    image = focus(beats, pulses.measured, flight.chirp, grid, aperture)
    return image.power, grid.along_m - 4.0


def inside(along_m: np.ndarray, south_m: float, north_m: float) -> np.ndarray:
    return (along_m > south_m + 0.06) & (along_m < north_m - 0.06)


def test_speckle_is_exponential_with_a_contrast_of_one(field):
    power, along = field
    halves = [power[:, inside(along, *ends)] for ends in ((-HALF_M, 0.0), (0.0, HALF_M))]
    samples = np.concatenate([(half / half.mean()).ravel() for half in halves])
    assert len(samples) > 500
    assert samples.std() == pytest.approx(1.0, abs=0.12)
    assert kstest(samples, "expon").pvalue > 0.01


def test_a_step_of_three_decibels_is_seen_where_it_is(field):
    power, along = field
    profile = power.mean(axis=0)
    dark, bright = (profile[inside(along, *ends)].mean() for ends in ((-HALF_M, 0.0), (0.0, HALF_M)))
    assert 10 * np.log10(bright / dark) == pytest.approx(BRIGHT_DB, abs=0.7)
    outside = profile[np.abs(along) > HALF_M + 0.15].mean()
    assert outside < 0.01 * dark
    # The step that fits the profile best, in logarithms as speckle multiplies.
    middle = np.abs(along) < HALF_M - 0.06
    place, level = along[middle], np.log(profile[middle])
    edges = np.arange(-1.0, 1.0, 0.02)
    misfit = [sum(np.sum((s - s.mean()) ** 2) for s in (level[place < e], level[place >= e])) for e in edges]
    assert abs(edges[int(np.argmin(misfit))]) < 0.2
