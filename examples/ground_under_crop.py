"""The ground under the crop by six methods: the table and the picture of `docs/crops.md`.

python examples/ground_under_crop.py [--picture] [words of the worlds' names ...]; two rows need cloth-simulation-filter
"""

import importlib.util
import os
import sys

import numpy as np
from scipy.interpolate import LinearNDInterpolator

from sionna_radar import load_scenario, run
from sionna_radar.accuracy import errors_by_cover
from sionna_radar.surfaces import Foliage

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
    crop, stage, seed = world.split(",")[0].split()
    drawn = {"seed": int(seed), "terrain.seed": int(seed), "vegetation": [FIELD | {"crop": crop, "stage": stage}]}
    return load_scenario("hills", FLIGHT | WORLDS[world] | drawn | more)


def linear(place_m, grid):
    return LinearNDInterpolator(place_m[:, :2], place_m[:, 2])(grid.centres_m).reshape(grid.shape)


def on_cloth(place_m):
    """Return whether points are of the ground by cloth simulation (Zhang et al. 2016); None where it is missing."""
    if importlib.util.find_spec("CSF") is None:
        return None
    import CSF

    cloth, ground, other = CSF.CSF(), CSF.VecInt(), CSF.VecInt()
    cloth.params.cloth_resolution, cloth.params.class_threshold, cloth.params.rigidness = CLOTH_M, ON_CLOTH_M, STIFFNESS
    cloth.setPointCloud(place_m)
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)  # The library prints its progress.
    cloth.do_filtering(ground, other, False)
    os.dup2(kept, 1)
    return np.isin(np.arange(len(place_m)), np.array(ground, dtype=int))


def axes(survey):
    """Return where the beams' axes start and end on the ground, shape (pulse, 3) each."""
    pose, ground_m = survey.schedule.sample(survey.pulses).true, survey.prepared.world.ground_m
    end_m = pose.position_m
    for _ in range(60):
        above_m = end_m[:, 2] - ground_m(end_m[:, :2])
        end_m = end_m - (above_m / pose.boresight[:, 2])[:, None] * pose.boresight
    return pose.position_m, end_m


def lidar(survey):
    """Return points of a lidar along the beams' axes, and which are leaves; Beer and Lambert's law stops its rays."""
    table, cover = survey.scenario.vegetation[0], survey.prepared.world.scene.vegetation
    leaf = {"leaf_thickness_m": table.planted.leaf_thickness_mm / 1e3, "water_content": table.grown.water_content}
    per_leaf_area = Foliage(leaf_area_per_m=1.0, **leaf).extinction_per_m(survey.scenario.radar.carrier_hz)
    light_per_m = LIGHT_PER_LEAF_AREA * cover.extinction_per_m[0] / per_leaf_area
    (start_m, end_m), random = axes(survey), np.random.default_rng(survey.scenario.seed)
    reach_m = np.linalg.norm(end_m - start_m, axis=1)
    along = (end_m - start_m) / reach_m[:, None]
    back_m = np.arange(1.5 * cover.highest_m / np.abs(along[:, 2]).min(), 0.0, -STEP_M)  # From above all plants.
    at = end_m[:, None] - back_m[None, :, None] * along[:, None]
    row, column, inside = (each.reshape(at.shape[:2]) for each in cover.grid.cell_of(at[..., :2].reshape(-1, 2)))
    leaves = inside & (at[..., 2] < cover.top_m[row, column]) & (at[..., 2] > cover.bottom_m[row, column])
    depth = np.cumsum(leaves * light_per_m * STEP_M, axis=1)
    stopped = depth > random.exponential(size=len(at))[:, None]
    of_leaves = stopped.any(axis=1)
    reach_m += random.normal(0.0, RANGE_NOISE_M, len(at)) - np.where(of_leaves, back_m[stopped.argmax(axis=1)], 0.0)
    return start_m + reach_m[:, None] * along, of_leaves


def maps(world):
    """Return the survey of "canopy", and each rival's map, the points that it takes for ground, and those of plants."""
    survey = run(scenario(world, **{"dem.method": "canopy"}))
    grid, cover = survey.dem.grid, survey.prepared.world.scene.vegetation
    peak = run(scenario(world, **{"processing.ranging": "peak", "dem.method": "linear"}))
    every = run(scenario(world, **{"processing": {"echoes": "all", "merge_gap_m": 0.0}, "dem.method": "linear"}))
    place_m, pulse = every.points.position_m, every.points.pulse
    last = np.append(pulse[1:] != pulse[:-1], True)
    others = {"strongest peak": (peak.dem.height_m, np.ones(len(peak.points), dtype=bool), peak.of_plants)}
    others["last peak"] = linear(place_m[last], grid), last, every.of_plants
    for name, points_m, of_plants in (("cloth", place_m, every.of_plants), ("lidar", *lidar(survey))):
        ground = on_cloth(points_m)
        others[name] = None if ground is None else (linear(points_m[ground], grid), ground, of_plants)
    ends_m = axes(survey)[1]
    others["ideal at gaps"] = linear(ends_m[np.isnan(cover.at(ends_m[:, :2]))], grid), None, None
    return survey, others


def f1(ground, of_plants):
    return np.nan if ground is None else 2 * np.sum(ground & ~of_plants) / max(np.sum(ground) + np.sum(~of_plants), 1)


def errors(survey, height_m):
    """Return the errors of a map under plants by their cover: cells that were lit and that "canopy" fills."""
    share = survey.prepared.world.scene.vegetation.fraction_over(survey.dem.grid)
    error_m = height_m - survey.prepared.truth.ground.height_m
    some = survey.lit & survey.dem.filled & np.isfinite(error_m) & (share > 0)
    return errors_by_cover(error_m[some], np.ones(some.sum()), share[some]).values()


def print_table(wanted):
    """Print a row for each world and method: RMS errors in metres and number of cells by cover, and F1."""
    for number, world in enumerate(wanted):
        survey, others = maps(world)
        check = survey.canopy_check
        if number == 0:
            print(f"{'':40}{'method':16}" + "".join(f"{name:>14}" for name in check.ground) + f"{'F1':>7}")
        rows = {"canopy": (check.ground.values(), check.f1)}
        rows |= {name: found and (errors(survey, found[0]), f1(*found[1:])) for name, found in others.items()}
        for name, row in rows.items():
            cells = [f"{each.rms_m:8.3f} ({each.count:3})" for each in row[0]] if row else ["  needs the package CSF"]
            print(f"{world:40}{name:16}{''.join(cells)}" + (f"{row[1]:7.3f}" if row else ""), flush=True)
        print(f"{'':10}invented {check.invented:.2%}, missed {check.missed:.1%}, height {check.height.rms_m:.2f} m "
              f"({check.height.count}), in 68 and 95 % by cover, and of heights: "
              + ", ".join(" ".join(f"{share:.2f}" for share in each.coverage.values())
                          for each in (*check.ground.values(), check.height)), flush=True)  # fmt: skip


def draw(world):
    """Save a cross-section from west to east through a world, from field to bare soil."""
    import matplotlib.pyplot as plt

    survey, others = maps(world)
    canopy, grid = survey.canopy, survey.dem.grid
    row, x_m = grid.rows // 2, np.arange(*grid.extent_m[:2], 0.02)
    line_m = np.column_stack([x_m, np.full(len(x_m), grid.y_m[row])])
    ground_m, tops_m = survey.prepared.world.ground_m(line_m), survey.prepared.world.scene.vegetation.tops_m(line_m)
    figure, axes = plt.subplots(figsize=(9.0, 3.6), layout="constrained")
    axes.fill_between(x_m, ground_m, np.maximum(tops_m, ground_m), color="#cfe3c0", lw=0, label="plants")
    axes.plot(x_m, ground_m, "k", lw=1.2, label="ground")
    ground, top = (canopy.ground, canopy.ground_sigma, "#b5541c"), (canopy.top, canopy.top_sigma, "#2c7a2c")
    for name, (surface, sigma, colour) in {"ground of canopy, 95 %": ground, "top of canopy, 95 %": top}.items():
        wanted = (canopy.plants.height_m[row] > 0.5) | (surface is canopy.ground)
        height_m, band_m = (np.where(wanted, each.height_m[row], np.nan) for each in (surface, sigma))
        axes.plot(grid.x_m, height_m, color=colour, lw=1.2, label=name)
        axes.fill_between(grid.x_m, height_m - 1.96 * band_m, height_m + 1.96 * band_m, color=colour, alpha=0.25, lw=0)
    axes.plot(grid.x_m, others["strongest peak"][0][row], "--", color="#3355aa", lw=1.2, label="strongest peak")
    axes.set(xlabel="east (m)", ylabel="height (m)", title=world)
    axes.legend(fontsize=8)
    figure.savefig("ground_under_crop.png", dpi=150)


if __name__ == "__main__":
    chosen = [world for world in WORLDS if all(word in world for word in sys.argv[1:] if word != "--picture")]
    draw(chosen[0]) if "--picture" in sys.argv else print_table(chosen)
