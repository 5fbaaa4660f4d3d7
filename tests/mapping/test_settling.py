"""Iterations that rest: their mixing, and the surface that rounding must not move."""

from dataclasses import replace

import numpy as np
import pytest

from sightings import make_sightings
from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.foundation.raster import Grid
from sionna_radar.inference.anderson import AndersonAcceleration
from sionna_radar.inference.echo.likelihood import EchoLikelihood, spline_taps
from sionna_radar.mapping.refined.refinement import CONVERGED_M, refine
from sionna_radar.radar.chirp import Chirp

WIDE = Grid(west_m=-20.0, south_m=-100.0, spacing_m=1.0, columns=200, rows=200)
PART = Grid(west_m=45.0, south_m=-20.0, spacing_m=1.0, columns=41, rows=41)


@pytest.fixture(scope="module")
def surface():
    x, y = np.meshgrid(WIDE.x_m, WIDE.y_m)
    return Heightfield(grid=WIDE, height_m=1.5 * np.sin(x / 9) * np.cos(y / 11))


@pytest.fixture(scope="module")
def some(surface):
    return make_sightings(surface)


def test_mixed_steps_solve_a_system_in_which_plain_ones_swing():
    rate = np.array([0.3, 1.0, 2.5, 4.0])
    place, mixing = np.zeros(4), AndersonAcceleration()
    for _ in range(8):
        place = mixing.next(place, 1 - rate * place, 1 - rate * place)
    np.testing.assert_allclose(place, 1 / rate, atol=1e-6)


def test_splines_are_the_response_of_a_window_on_cells_and_between():
    chirp = Chirp(carrier_hz=77e9, bandwidth_hz=500e6, rate_hz=360.0, samples=1024)
    samples = np.arange(chirp.samples)
    window = 0.5 - 0.5 * np.cos(2 * np.pi * samples / chirp.samples)
    cell = np.linspace(-4, 4, 33)
    power = np.abs(np.exp(-2j * np.pi * np.outer(cell, samples) / chirp.samples) @ window) ** 2
    taps = spline_taps(power[::4] / power[::4].sum())
    away = np.abs(np.subtract.outer(cell, np.arange(len(taps)) - len(taps) // 2))
    spline = np.where(away < 1, 2 / 3 - away**2 * (1 - away / 2), np.maximum(2 - away, 0) ** 3 / 6)
    np.testing.assert_allclose(spline @ taps, power / power[::4].sum(), atol=3e-3)


def test_the_likelihood_has_no_kinks(some, surface):
    """What a surface gains is the integral of its score, however far it moves across range cells."""
    raised = [EchoLikelihood(some, replace(surface, height_m=surface.height_m + up)) for up in (0.1, 0.1001, 0.102)]
    looks = np.ones(len(some))
    here, near, far = (np.sum(model.linearise(looks).score, axis=1) for model in raised)
    np.testing.assert_allclose((near - here) / 1e-4, (far - here) / 2e-3, atol=0.15 * np.abs(far - here).max() / 2e-3)


def test_rounding_moves_no_map(some):
    shaken = np.random.default_rng(2).uniform(-1e-6, 1e-6, len(some.profiles.power)).astype(np.float32)
    profiles = replace(some.profiles, power=some.profiles.power * (1 + shaken))
    surfaces = [refine(sightings, PART).surface.height_m for sightings in (some, replace(some, profiles=profiles))]
    assert np.sqrt(np.mean((surfaces[1] - surfaces[0]) ** 2)) < CONVERGED_M
