"""Planes through heights on a line, level across it; how far means over long footprints leave curved ground."""

from dataclasses import replace

import numpy as np
import pytest

from sionna_radar.inference.terrain.heights import Heights, plane_through
from sionna_radar.mapping.stepped.planes import robust_plane

AWAY_M = np.array([400.0, -250.0])


def on_a_line(width_m: float, heading_deg: float, count: int = 500):
    rng = np.random.default_rng(4)
    ahead = np.array([np.sin(np.deg2rad(heading_deg)), np.cos(np.deg2rad(heading_deg))])
    across = np.array([ahead[1], -ahead[0]])
    along_m = rng.uniform(-100, 100, count)
    place_m = AWAY_M + along_m[:, None] * ahead + rng.normal(0, width_m, (count, 1)) * across
    # Roofs and streets, which no plane explains, on ground that rises by 0.1 along the line.
    return place_m, 20 + 0.1 * along_m + rng.choice([0.0, 12.0], count), ahead, across


@pytest.mark.parametrize("width_m", [0.0, 1e-6, 1e-3, 0.1])
@pytest.mark.parametrize("heading_deg", [0.0, 33.0, 90.0])
def test_a_plane_through_a_line_is_level_across_it(width_m, heading_deg):
    place_m, height_m, ahead, across = on_a_line(width_m, heading_deg)
    slopes = plane_through(place_m, height_m)[1:]
    assert slopes @ ahead == pytest.approx(0.1, abs=0.02)
    assert slopes @ across == pytest.approx(0.0, abs=1e-3)
    heights = Heights.at_places(place_m, height_m - 12 * (height_m > 26), np.full(len(place_m), 0.1))
    plane = robust_plane(heights, 0.0, 4.0).plane
    assert abs(plane.coefficients[1:] @ across) < 1e-3
    away = plane.middle_m + 40.0 * across
    assert plane.sigma_m(away[None])[0] > 5.0


def test_a_plane_through_one_place_is_level():
    place_m = np.tile(AWAY_M, (20, 1))
    np.testing.assert_allclose(plane_through(place_m, np.full(20, 7.0)), [7.0, 0.0, 0.0], atol=1e-9)


def test_a_plane_through_a_swath_is_that_of_least_squares():
    rng = np.random.default_rng(2)
    place_m = AWAY_M + rng.uniform(-1, 1, (300, 2)) * [100.0, 8.0]
    height_m = 3 + place_m @ [0.2, -0.4] + rng.normal(0, 0.1, 300)
    design = np.column_stack([np.ones(300), place_m])
    np.testing.assert_allclose(plane_through(place_m, height_m), np.linalg.lstsq(design, height_m, rcond=None)[0])


@pytest.mark.parametrize("axes_m", [(2.0, 2.0), (3.0, 1.5), (4.0, 0.0)])
def test_means_over_long_footprints_leave_curved_ground_as_those_over_a_round_one(axes_m):
    """Ground of waves in all directions, in the middle of which each footprint lies, turned at random."""
    rng, count = np.random.default_rng(3), 4000
    heading = rng.uniform(0, 2 * np.pi, (count, 40))
    wave = 2 * np.pi / 60.0 * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    amplitude = np.cos(rng.uniform(0, 2 * np.pi, heading.shape))
    turn = rng.uniform(0, 2 * np.pi, count)
    along = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    across = np.stack([-np.sin(turn), np.cos(turn)], axis=1)
    axes = np.stack([axes_m[0] * along, axes_m[1] * across], axis=1)
    heights = replace(Heights.at_places(np.zeros((count, 2)), np.zeros(count), np.ones(count)), footprint_m=axes)

    def left_m(spread2: np.ndarray) -> np.ndarray:
        # The mean of a wave over a Gaussian footprint is exp(-k'Sk / 2) of it.
        return np.sum(amplitude * (1 - np.exp(-spread2 / 2)), axis=1)

    long = left_m(np.sum(np.einsum("nwi,nai->nwa", wave, axes) ** 2, axis=-1))
    round_one = left_m(np.sum(wave**2, axis=-1) * heights.bent_spread_m[:, None] ** 2)
    assert np.std(long) == pytest.approx(np.std(round_one), rel=0.05)
    assert heights.bent_spread_m.min() >= heights.spread_m.max() - 1e-12
