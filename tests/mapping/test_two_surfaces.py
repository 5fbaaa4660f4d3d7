"""Ground and plants at nodes: Gaussian evidence stays what it is, and neighbours decide what echoes leave open."""

import numpy as np
import pytest

from sionna_radar.mapping.canopy.two_surfaces import NodeEvidence, two_surfaces

GROUND_M = np.arange(-2.0, 2.01, 0.1)
RNG = np.random.default_rng(4)
PLACE_M = RNG.uniform(0, 60, (600, 2))
TRUE_M = 2.0 * np.sin(PLACE_M[:, 0] / 15) + 0.02 * PLACE_M[:, 1]
LAYER_M = 1.5


def evidence(bare, layer):
    """Return evidence over a level reference that follows the ground to a metre, for layers of one thickness."""
    shape = layer.shape
    return NodeEvidence(
        place_m=PLACE_M,
        reference_m=np.zeros(len(PLACE_M)),
        ground_m=GROUND_M,
        bare=bare.astype(np.float32),
        layer=layer.astype(np.float32),
        thickness_m=np.full(shape, LAYER_M, dtype=np.float32),
        square_m2=np.full(shape, LAYER_M**2 + 0.04, dtype=np.float32),
    )


def peak(height_m, sigma_m):
    """Return the log-likelihood of a Gaussian measurement."""
    return -0.5 * ((GROUND_M - height_m[:, None]) / sigma_m) ** 2


def around(true_m):
    """Return places where the ground is within the heights that are tried."""
    return np.abs(true_m) < 1.5


def test_gaussian_evidence_of_bare_ground():
    """Each node says what it measured, with its error; together they know the ground better, and as well as stated."""
    sigma_m = 0.15
    measured_m = 0.5 * TRUE_M + RNG.normal(0, sigma_m, len(TRUE_M))
    found = two_surfaces(evidence(peak(measured_m, sigma_m), np.full((600, 2, len(GROUND_M)), -50.0)), 0.0)
    inside = around(measured_m)
    np.testing.assert_allclose(found.own_m[inside], measured_m[inside], atol=0.02)
    np.testing.assert_allclose(found.own_sigma_m[inside], sigma_m, rtol=0.15)
    error = (found.ground_m - 0.5 * TRUE_M)[inside]
    assert np.std(error) < 0.5 * sigma_m
    assert np.std(error / found.ground_sigma_m[inside]) == pytest.approx(1.0, abs=0.25)
    assert found.plants.max() < 0.01


def test_evidence_that_ends_in_a_cliff_puts_no_ground_beside_it():
    """Heights too low for the echo say nothing, the next ones 170 nepers, and the ground 185, as of a wide beam."""
    found_m = 0.2 * np.sin(PLACE_M[:, 0] / 15) + 0.8 + RNG.normal(0, 0.05, len(TRUE_M))
    bare = 185 + peak(found_m, 0.15)
    cliff_m = RNG.uniform(-1.8, -0.8, (len(TRUE_M), 1))
    bare = np.where(cliff_m > GROUND_M, 0.0, np.maximum(bare, 170 + 3 * (GROUND_M - cliff_m)))
    found = two_surfaces(evidence(bare, np.repeat(bare[:, None] - 2.0, 2, axis=1)), 0.0)
    np.testing.assert_allclose(found.own_m[found.heard], found_m[found.heard], atol=0.1)
    assert found.heard.mean() > 0.95
    assert found.plants.max() < 0.1


def test_neighbours_tell_which_of_two_ends_is_the_ground():
    """A third of the nodes hears the top alone, which may be bare ground or a layer: as around, it is a layer."""
    sigma_m, ground_m = 0.1, 0.5 * TRUE_M - 0.5
    low, high = peak(ground_m, sigma_m), peak(ground_m + LAYER_M, sigma_m)
    unclear = RNG.random(len(PLACE_M)) < 1 / 3
    bare = np.where(unclear[:, None], high, -40.0 + high)
    found = two_surfaces(evidence(bare, np.repeat(low[:, None], 2, axis=1)), 0.0)
    inside = around(ground_m) & around(ground_m + LAYER_M)
    assert np.all(found.plants[inside] > 0.9)
    assert np.sqrt(np.mean((found.ground_m - ground_m)[inside] ** 2)) < 0.05
    np.testing.assert_allclose(found.thickness_m[inside], LAYER_M, atol=1e-6)


def test_types_that_move_the_ground_are_an_error_that_is_shared():
    """Two types explain all echoes alike, and say grounds 0.4 m apart: that does not average out over nodes."""
    sigma_m, ground_m = 0.2, 0.5 * TRUE_M - 0.5
    layer = np.stack([peak(ground_m, sigma_m), peak(ground_m + 0.4, sigma_m)], axis=1)
    found = two_surfaces(evidence(np.full((600, len(GROUND_M)), -60.0), layer), 0.0)
    inside = around(ground_m)
    assert np.median(found.ground_sigma_m[inside]) < 0.12
    assert np.median(found.shared_sigma_m[inside]) == pytest.approx(0.2, abs=0.06)
    one = two_surfaces(evidence(np.full((600, len(GROUND_M)), -60.0), layer[:, :1]), 0.0)
    assert np.median(one.shared_sigma_m[inside]) < 0.02


def test_echoes_that_say_nothing_anywhere():
    """Without evidence no node is heard, and the ground is anywhere within the heights that were tried."""
    nothing = np.zeros((600, len(GROUND_M)))
    found = two_surfaces(evidence(nothing, nothing[:, None]), 0.0)
    assert not found.heard.any()
    assert len(found.own_heights()) == 0
    assert np.all(found.ground_sigma_m > 0.5)


def test_nodes_without_evidence_take_their_neighbours_ground():
    """Where the echoes say nothing, the ground is that of kriging, and wider."""
    sigma_m, ground_m = 0.1, 0.5 * TRUE_M
    bare = peak(ground_m, sigma_m)
    silent = (np.abs(PLACE_M[:, 0] - 30) < 3) & (np.abs(PLACE_M[:, 1] - 30) < 3)
    # As good as nothing: less than a hundredth of a neper over all heights, which would point far beyond them.
    bare[silent] = 0.002 * GROUND_M
    found = two_surfaces(evidence(bare, np.full((600, 1, len(GROUND_M)), -50.0)), 0.0)
    assert np.all(found.own_sigma_m[silent] > 10)
    assert np.max(np.abs(found.ground_m - ground_m)[silent]) < 0.1
    assert found.ground_sigma_m[silent].mean() > found.ground_sigma_m[around(ground_m) & ~silent].mean()
    assert np.abs(found.own_m).max() <= GROUND_M[-1]
    assert found.plants.max() < 0.5
