"""
The ground under the crop, by seven methods
===========================================

One flight over each field, 20 m above the ground: how far maps of the ground lie from the bare earth under plants, and
how well each method tells which of its points are ground (the table of `docs/crops.md`)::

    python examples/ground_under_crop.py
    python examples/ground_under_crop.py maize "24 GHz"
    python examples/ground_under_crop.py --picture

The cloth simulation needs `pip install cloth-simulation-filter`; without it its rows say so.
"""

import contextlib
import importlib.util
import os
import sys
from pathlib import Path

import numpy as np
from scipy.interpolate import LinearNDInterpolator

from sionna_radar import load_scenario, run
from sionna_radar.accuracy.canopy import COVERS, SurfaceErrors
from sionna_radar.surfaces.foliage import Foliage

FLIGHT = {
    "radar.chirp_rate_hz": 1500.0,
    "radar.bandwidth_hz": 1e9,
    "radar.scan": {"incidence_deg": 20.0, "half_swath_deg": 40.0, "rotation_rpm": 300.0},
    "platform": {"altitude_m": 20.0, "length_m": 40.0, "start_m": [-20.0, 0.0], "speed_mps": 8.0},
    "materials.ground": {"model": "constant_gamma", "gamma_db": -10.0},
    "terrain.height_m": 2.0,
}
AT_24_GHZ = {"radar.carrier_hz": 24.1e9, "radar.bandwidth_hz": 250e6, "radar.antenna.beamwidth_deg": 4.0}
FIELD = {"kind": "crop", "polygon_m": [[-100, -100], [0, -100], [0, 100], [-100, 100]], "row_heading_deg": 30.0}
# Crop, stage and seed; the constants of "canopy" were chosen on the worlds of seed 1.
FIELDS_77 = ("maize stem_elongation 1, maize flowering 1, vines flowering 1, orchard flowering 1, wheat flowering 12, "
             "grass before_cutting 13, orchard fruit_development 14, vines ripening 15, maize ripe 16")  # fmt: skip
FIELDS_24 = "wheat flowering 17, orchard fruit_development 19, vines ripening 20, maize ripe 21"
WORLDS = {f"{field}, 77 GHz": {} for field in FIELDS_77.split(", ")}
WORLDS |= {f"{field}, 24 GHz": AT_24_GHZ for field in FIELDS_24.split(", ")}
# Cloth, chosen on the same worlds: spacing of its particles, farthest point of the ground from it, m; stiffness.
CLOTH_M, ON_CLOTH_M, STIFFNESS = 2.0, 0.2, 3
# Lidar: range noise, and the step at which a ray looks for leaves, m; one-way extinction of light per leaf area.
RANGE_NOISE_M, STEP_M, LIGHT_PER_LEAF_AREA = 0.03, 0.05, 0.5


def scenario(world, **more):
    """Return the scenario of a world by its name, with other keys."""
    crop, stage, seed = world.split(",")[0].split()
    plants = {"vegetation": [FIELD | {"crop": crop, "stage": stage}], "seed": int(seed), "terrain.seed": int(seed)}
    return load_scenario("hills", FLIGHT | WORLDS[world] | plants | more)


def linear(place_m, grid):
    """Return heights between points, linear in Delaunay triangles, at the cells of a grid."""
    if len(place_m) < 3:
        return np.full(grid.shape, np.nan)
    return LinearNDInterpolator(place_m[:, :2], place_m[:, 2])(grid.centres_m).reshape(grid.shape)


def on_cloth(place_m):
    """Return whether points are of the ground by cloth simulation (Zhang et al. 2016); None where it is missing."""
    if importlib.util.find_spec("CSF") is None:
        return None
    import CSF

    cloth, ground, other = CSF.CSF(), CSF.VecInt(), CSF.VecInt()
    cloth.params.cloth_resolution, cloth.params.class_threshold, cloth.params.rigidness = CLOTH_M, ON_CLOTH_M, STIFFNESS
    cloth.setPointCloud(place_m)
    with silence():
        cloth.do_filtering(ground, other, False)
    return np.isin(np.arange(len(place_m)), np.array(ground, dtype=int))


@contextlib.contextmanager
def silence():
    """Send what a library prints by itself nowhere."""
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    sys.stdout.flush()
    os.dup2(nowhere, 1)
    yield
    os.dup2(kept, 1)
    os.close(kept)
    os.close(nowhere)


# %%
# The lidar looks along the axes of the same beams. A leaf stops a ray as Beer and Lambert have it, with half of the
# leaf area density per metre; each ray has one return, of the first leaf in its way or of the ground.
def axes(survey):
    """Return where the beams' axes start and end on the ground, shape (pulse, 3) each."""
    pose, ground_m = survey.schedule.sample(survey.pulses).true, survey.prepared.world.ground_m
    low_m, high_m = np.zeros(survey.pulses), np.full(survey.pulses, 200.0)
    for _ in range(40):
        middle = (low_m + high_m) / 2
        at = pose.position_m + middle[:, None] * pose.boresight
        above = at[:, 2] > np.nan_to_num(ground_m(at[:, :2]), nan=-np.inf)
        low_m, high_m = np.where(above, middle, low_m), np.where(above, high_m, middle)
    return pose.position_m, pose.position_m + high_m[:, None] * pose.boresight


def lidar(survey):
    """Return the lidar's points, and which are of leaves."""
    table, cover = survey.scenario.vegetation[0], survey.prepared.world.scene.vegetation
    leaf = {"leaf_thickness_m": table.planted.leaf_thickness_mm / 1e3, "water_content": table.grown.water_content}
    per_leaf_area = Foliage(leaf_area_per_m=1.0, **leaf).extinction_per_m(survey.scenario.radar.carrier_hz)
    light_per_m = LIGHT_PER_LEAF_AREA * cover.extinction_per_m[0] / per_leaf_area
    start_m, end_m = axes(survey)
    random = np.random.default_rng(survey.scenario.seed)
    reach_m = np.linalg.norm(end_m - start_m, axis=1)
    along = (end_m - start_m) / reach_m[:, None]
    # From above all plants down to the ground.
    back_m = np.arange(1.5 * cover.highest_m / np.abs(along[:, 2]).min(), 0.0, -STEP_M)
    at = end_m[:, None] - back_m[None, :, None] * along[:, None]
    row, column, inside = cover.grid.cell_of(at[..., :2].reshape(-1, 2))
    height_m = at[..., 2].ravel()
    leaves = inside & (height_m < cover.top_m[row, column]) & (height_m > cover.bottom_m[row, column])
    depth = np.cumsum(leaves.reshape(len(at), -1) * light_per_m * STEP_M, axis=1)
    stopped = depth > random.exponential(size=len(at))[:, None]
    of_leaves = stopped.any(axis=1)
    reach_m = reach_m - np.where(of_leaves, back_m[stopped.argmax(axis=1)], 0.0)
    reach_m = reach_m + random.normal(0.0, RANGE_NOISE_M, len(at))
    return start_m + reach_m[:, None] * along, of_leaves


# %%
# Each method gives a map of the ground, the points that it takes for ground, and which points plants returned.
def maps(world):
    """Return the survey of "canopy" over a world, and of the other methods their maps, ground points and plants."""
    survey = run(scenario(world, **{"dem.method": "canopy"}))
    grid, cover = survey.dem.grid, survey.prepared.world.scene.vegetation
    peak = run(scenario(world, **{"processing.ranging": "peak", "dem.method": "linear"}))
    every = run(scenario(world, **{"processing": {"echoes": "all", "merge_gap_m": 0.0}, "dem.method": "linear"}))
    place_m, pulse = every.points.position_m, every.points.pulse
    last = np.append(pulse[1:] != pulse[:-1], True)
    others = {
        "strongest peak": (peak.dem.height_m, np.ones(len(peak.points), dtype=bool), peak.of_plants),
        "last peak": (linear(place_m[last], grid), last, every.of_plants),
    }
    returns_m, of_leaves = lidar(survey)
    for name, points_m, of_plants in (("cloth", place_m, every.of_plants), ("lidar", returns_m, of_leaves)):
        ground = on_cloth(points_m)
        others[name] = None if ground is None else (linear(points_m[ground], grid), ground, of_plants)
    ends_m = axes(survey)[1]
    others["ideal at gaps"] = (linear(ends_m[np.isnan(cover.at(ends_m[:, :2]))], grid), None, None)
    return survey, others


def f1(ground, of_plants):
    """Return the harmonic mean of precision and recall of the points taken for ground."""
    if ground is None:
        return np.nan
    right = np.sum(ground & ~of_plants)
    return 2 * right / max(np.sum(ground) + np.sum(~of_plants), 1)


def errors(survey, height_m):
    """Return the errors of a map under plants by their cover: cells that were lit and that "canopy" fills."""
    share = survey.prepared.world.scene.vegetation.share_over(survey.dem.grid)
    error_m = height_m - survey.prepared.truth.ground.height_m
    some = survey.lit & survey.dem.filled & np.isfinite(error_m) & (share > 0)
    cells = [some & (share > low) & (share <= high) for low, high in COVERS.values()]
    return [SurfaceErrors.of(error_m[each], np.ones(each.sum())) for each in cells]


def print_table(wanted):
    """Print a row for each world and method: RMS errors in metres by cover, and F1."""
    print(f"{'':40}{'method':16}" + "".join(f"{name:>13}" for name in COVERS) + f"{'F1':>7}")
    for world in wanted:
        survey, others = maps(world)
        check = survey.canopy_check
        print(f"{world:40}{'canopy':16}{_cells(list(check.ground.values()))}{check.f1:7.3f}", flush=True)
        for name, result in others.items():
            if result is None:
                print(f"{'':40}{name:16}  needs the package cloth-simulation-filter")
                continue
            print(f"{'':40}{name:16}{_cells(errors(survey, result[0]))}{f1(*result[1:]):7.3f}", flush=True)
        inside = " ".join(f"{each.coverage['68']:.2f}/{each.coverage['95']:.2f}" for each in check.ground.values())
        print(f"{'':40}height {check.height.rms_m:.2f} m over {check.height.count} cells, invented {check.invented:.2%},"
              f" missed {check.missed:.1%}, within 68/95 %: {inside}, height {check.height.coverage['68']:.2f}/"
              f"{check.height.coverage['95']:.2f}", flush=True)  # fmt: skip


def _cells(found):
    return "".join(f"{each.rms_m:7.3f} ({each.count:3})" for each in found)


if __name__ == "__main__":
    words = [word for word in sys.argv[1:] if word != "--picture"]
    print_table([world for world in WORLDS if all(word in world for word in words)])
