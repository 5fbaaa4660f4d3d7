"""
Paper Fig. 10: two fields and a point target
============================================

Flat ground, half of gamma -28 dB and half of -25 dB, and a point target P. The power map separates the fields
through speckle. How well, is measured: the left and the right of the track see the same ranges and incidences, so
that the ratio of their mean powers at equal scan angles is the step, and its scatter over the angles the error.
"""

# %%
import os

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from sionna_radar import load_scenario, run
from sionna_radar.report import colour_bar, finish_map

SMALL = "SIONNA_RADAR_SMALL" in os.environ
SEEDS = range(1, 3 if SMALL else 9)
TARGET_M = np.array([0.0, -20.0])
CLEAR_M = 12.0  # around P, whose side lobes reach beyond its footprint
CLEAR_DEG = 4.0  # about the boundary under the track, where one beam sees both fields


# %%
def pair_ratios_db(survey):
    """Mean power of the strong field over that of the weak one, dB, for each pair of scan angles to left and right."""
    points = survey.points
    scan_deg = np.rad2deg(survey.schedule.pulses(points.pulse).scan_rad)
    away = np.linalg.norm(points.position_m[:, :2] - TARGET_M, axis=1) > CLEAR_M
    step_deg = 360 * scenario.radar.scan.rotation_rpm / 60 / scenario.radar.chirp_rate_hz
    group = np.floor(np.abs(scan_deg) / step_deg).astype(int)
    ratios = []
    for number in np.unique(group[np.abs(scan_deg) > CLEAR_DEG]):
        here = (group == number) & away
        strong, weak = here & (points.position_m[:, 1] > 0), here & (points.position_m[:, 1] < 0)
        if strong.sum() > 3 and weak.sum() > 3:
            ratios.append(10 * np.log10(points.power[strong].mean() / points.power[weak].mean()))
    return np.array(ratios)


scenario = load_scenario("two_fields")
surveys = {seed: run(load_scenario("two_fields", {"seed": seed})) for seed in SEEDS}
ratios = {seed: pair_ratios_db(survey) for seed, survey in surveys.items()}
every = np.concatenate(list(ratios.values()))
step_db, error_db = every.mean(), every.std(ddof=1) / np.sqrt(len(every))
one = ratios[1]
print(f"seed 1: {one.mean():.2f} +- {one.std(ddof=1) / np.sqrt(len(one)):.2f} dB from {len(one)} pairs of scan angles")
print(f"{len(SEEDS)} seeds: {step_db:.2f} +- {error_db:.2f} dB; the scene has 3 dB")

# %%
# P against the ground around it.
points = surveys[1].points
from_target = np.linalg.norm(points.position_m[:, :2] - TARGET_M, axis=1)
around = points.power[(from_target > CLEAR_M) & (from_target < 2 * CLEAR_M) & (points.position_m[:, 1] < 0)]
hot_db = 10 * np.log10(points.power[from_target < CLEAR_M].max() / np.median(around))
print(f"P stands {hot_db:.0f} dB above the median of the ground around it")

# %%
figure = Figure(figsize=(11.0, 5.2), layout="constrained")
plan, profile = figure.subplots(1, 2, width_ratios=[1.25, 1.0])
power_db = 10 * np.log10(points.power)
limits = Normalize(*np.percentile(power_db, [2, 99]))
plan.scatter(*points.position_m[:, :2].T, c=power_db, s=26, lw=0, cmap="viridis", norm=limits)
halo = [withStroke(linewidth=3.0, foreground="white")]
arrow = {"arrowstyle": "->", "lw": 1.6, "path_effects": halo}
plan.annotate("P", TARGET_M, (9, -29), weight="bold", size=13, path_effects=halo, arrowprops=arrow)
plan.axhline(0.0, color="black", lw=1.2, ls="--")
west, east = points.position_m[:, 0].min() - 3, points.position_m[:, 0].max() + 3
for y, text in ((57, "Field of γ = −25 dB"), (-57, "Field of γ = −28 dB")):
    plan.text(west + 3, y, text, va="center")
finish_map(plan, (west, east, -63, 75), "Power of the echoes (seed 1)")
colour_bar(plan, ScalarMappable(limits, "viridis"), "Echo power (dB rel. to transmitted)", 3.2, extend="both")

# %%
# The step at each pair of scan angles: speckle scatters it, the mean is the ratio of the fields.
angle_deg = np.arange(len(one)) * 2.0 + 5.0
for seed, values in ratios.items():
    label = "One pair, one seed" if seed == 1 else None
    dots = {"ls": "", "marker": "o", "ms": 3, "mew": 0, "color": "#0072b2", "alpha": 0.5}
    profile.plot(angle_deg[: len(values)], values, **dots, label=label)
profile.axhspan(2.7, 3.3, color="#e69f00", alpha=0.25, lw=0, label="3 dB ± 0.3 dB")
profile.axhline(step_db, color="#d55e00", lw=1.8, label=f"Mean: {step_db:.2f} ± {error_db:.2f} dB")
profile.set(xlabel="Scan angle to either side (deg)", ylabel="Power to the left over power to the right (dB)")
profile.set_title(f"The step between the fields ({len(SEEDS)} seeds)", fontsize="medium")
profile.set_ylim(-0.5, 8)
profile.legend(frameon=False, loc="upper left")
profile.grid(alpha=0.3)
figure.savefig("fig10_two_fields.png", dpi=150, bbox_inches="tight")
