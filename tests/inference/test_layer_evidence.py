"""Evidence for a layer of plants against brute force: mean profiles by rays and slices of height, levels by search."""

from dataclasses import replace

import numpy as np
import pytest

from sightings import CELL_M, CELLS, make_sightings
from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.foundation.numerics import MAX_SPECKLE
from sionna_radar.foundation.raster import Grid
from sionna_radar.inference.echo.layer import PEDESTAL, LayerHeights, LayerType, layer_evidence
from sionna_radar.radar.array_antenna import taylor_cut

GRID = Grid(west_m=-60.0, south_m=-90.0, spacing_m=2.0, columns=100, rows=90)
LEVEL = Heightfield(grid=GRID, height_m=np.zeros(GRID.shape))
HEIGHTS = LayerHeights(low_m=-2.0, step_m=0.2, count=21)
BEAM_DEG, LOOKS = 2.0, 0.7
MAIZE = LayerType(extinction_per_m=0.7, cover=0.8, backscatter=4.0)
VINES = LayerType(extinction_per_m=1.5, cover=0.4, backscatter=2.0, clear_m=0.6)
SIGHTINGS = make_sightings(LEVEL, BEAM_DEG)


def slant_profile(row, kind, ground_m, thickness_m):
    """Return the mean profile of a layer by 40,000 rays, each cut into 60 slices; of level 1."""
    rng = np.random.default_rng(row)
    cut = taylor_cut(np.deg2rad(BEAM_DEG), -20.0)
    u, v = rng.uniform(-1.2, 1.2, (2, 40_000)) * np.deg2rad(BEAM_DEG)
    share = (cut.at(u) * cut.at(v)) ** 4
    toward = np.column_stack([np.sqrt(1 - u**2 - v**2), u, v]) @ SIGHTINGS.pose.R_world_antenna[row].T
    up_m, down = SIGHTINGS.pose.position_m[row, 2], -toward[:, 2]
    slant = 1 / -SIGHTINGS.pose.boresight[row, 2]
    profile = np.zeros(CELLS)

    def add(height_m, part):
        range_m = (up_m - height_m) / down
        # As wide as a cell, and centred on it.
        profile[:] += np.bincount(np.rint(range_m / CELL_M).astype(int), part * share / range_m**2, CELLS)[:CELLS]

    depth = 2 * kind.extinction_per_m * slant
    cover = 1 - (1 - kind.cover) ** (1 + np.sqrt(slant**2 - 1))
    leaves_m = max(thickness_m - kind.clear_m, 0.0)
    add(ground_m, 1 - cover + cover * np.exp(-depth * leaves_m) if leaves_m else 1.0)
    slices = 60
    for k in range(slices if leaves_m else 0):
        below_top_m = (k + 0.5) / slices * leaves_m
        part = depth * leaves_m / slices * np.exp(-depth * below_top_m)
        add(ground_m + thickness_m - below_top_m, kind.backscatter * cover * part)
    return profile


def log_likelihood(power, profile, noise):
    """Return the log-likelihood of exponential powers over that of noise, at the best level."""
    floor = noise + PEDESTAL * power.max()

    def loss(mean):
        ratio = power / mean
        glint = ratio > MAX_SPECKLE
        ratio[glint] = MAX_SPECKLE * (1 + np.log(ratio[glint] / MAX_SPECKLE))
        return np.sum(ratio + np.log(mean))

    scale = np.log(power.sum() / profile.sum())
    tried = scale + np.linspace(-6, 4, 400)
    return (loss(np.full(len(power), floor)) - min(loss(floor + np.exp(log) * profile) for log in tried)) * LOOKS


@pytest.mark.parametrize("kind", [MAIZE, VINES], ids=["maize", "vines"])
@pytest.mark.parametrize(("ground_m", "thickness_m"), [(0.0, 0.0), (-0.6, 1.4), (-1.0, 2.0)])
def test_noiseless_echoes_tell_ground_and_top(kind, ground_m, thickness_m):
    """Without speckle the likeliest top is the true one, ground within two steps; likelihoods are as by brute force."""
    rows = np.arange(0, len(SIGHTINGS), 25)
    power = np.array([1e9 * slant_profile(row, kind, ground_m, thickness_m) + 1e-6 for row in rows])
    some = SIGHTINGS.rows(np.isin(np.arange(len(SIGHTINGS)), rows))
    some = replace(some, profiles=replace(some.profiles, power=power.ravel().astype(np.float32)))
    log = layer_evidence(some, LEVEL, np.full(len(rows), LOOKS), HEIGHTS, (kind,), 16, 12).astype(float)
    ground, thickness = np.unravel_index(np.argmax(log[:, 0].sum(axis=0)), log.shape[2:])
    assert abs(HEIGHTS.height_m[ground] - ground_m) <= 2.01 * HEIGHTS.step_m
    top_m = HEIGHTS.height_m[ground + thickness]
    assert abs(top_m - ground_m - thickness_m) <= 1.01 * HEIGHTS.step_m
    for row, values, echo in zip(rows, log[:, 0], power, strict=True):
        for other in ((0, 0), (5, 5), (8, 0), (7, 9)):
            plain = log_likelihood(echo, slant_profile(row, kind, HEIGHTS.height_m[other[0]], 0.2 * other[1]), 1e-6)
            if kind.clear_m and 0 < 0.2 * other[1] <= kind.clear_m:
                continue
            assert values[other] == pytest.approx(plain, abs=0.06 * values.max())


def test_heights_out_of_sight_say_nothing():
    """A pulse that meets no surface, and tops beyond the highest height, are not judged."""
    away = replace(SIGHTINGS.pose, position_m=SIGHTINGS.pose.position_m + np.array([0.0, 0.0, 500.0]))
    log = layer_evidence(replace(SIGHTINGS, pose=away), LEVEL, np.ones(len(SIGHTINGS)), HEIGHTS, (MAIZE,), 16, 12)
    assert np.all(log == 0)
    log = layer_evidence(SIGHTINGS, LEVEL, np.ones(len(SIGHTINGS)), HEIGHTS, (MAIZE,), 16, 12)
    assert np.all(np.isneginf(log[:, :, 15, 6:]))
    assert np.all(np.isfinite(log[:, :, 15, :6]))
