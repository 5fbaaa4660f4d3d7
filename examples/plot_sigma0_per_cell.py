"""
Gamma of each cell of the ground
================================

A survey measures the mean power of each pulse in each range cell. The power is linear in the backscatter of the ground:
every traced path carries its share from one cell of the ground to one range cell of one pulse, and these shares are the
derivatives, a sparse matrix. One tracing gives all of them, and one sparse least squares some ten thousand
unknowns; difference quotients would trace the survey once more for each unknown.

The measured profiles are traced with other rays than the matrix, so that the error of both is in the result.
"""

# %%
import os
import time

import numpy as np
from matplotlib.figure import Figure
from scipy.constants import speed_of_light
from scipy.sparse import coo_array, diags_array, eye_array, kron, vstack
from scipy.sparse.linalg import cg

from sionna_radar import load_scenario, prepare

SMALL = "SIONNA_RADAR_SMALL" in os.environ
CELL_M = 1.0
# Neighbouring cells differ by about this share of gamma, and a measured power is known to this share.
CONTRAST, NOISE = 0.1, 0.1
BLOCK = 500

flight = {
    "platform.length_m": 25.0 if SMALL else 100.0,
    "radar.scan.rotation_rpm": 240.0,
    "radar.chirp_rate_hz": 1440.0,
    "tracing.speckle": "per_pulse",
    "tracing.paths_per_pulse": 256,
}
scenario = load_scenario("two_fields", flight)
uniform = {f"materials.{name}": {"model": "constant_gamma", "gamma_db": 0.0} for name in scenario.all_materials}


# %%
def traced(survey):
    """Return pulse and range cell, place on the ground, and mean power of every path of a survey."""
    resolution_m = survey.receiver.chirp.range_resolution_m
    rows, places, powers = [], [], []
    for first in range(0, len(survey), BLOCK):
        paths = survey.paths(np.arange(first, min(first + BLOCK, len(survey))))
        paths = paths.rows(paths.surface >= 0)
        cell = (paths.delay_s * speed_of_light / 2 / resolution_m).astype(int)
        rows.append(paths.pulse * 4096 + cell)
        places.append(paths.hit_m[:, :2])
        powers.append(np.abs(paths.gain.astype(complex)) ** 2)
    return np.concatenate(rows), np.concatenate(places), np.concatenate(powers)


# The measurement: the scene's own covers, met by rays of another seed.
truth = prepare(scenario.replace({"seed": 2}))
measured_row, _, measured_power = traced(truth)

# %%
# The matrix: the same flight over ground of a gamma of 1.
begin = time.perf_counter()
row, place_m, power = traced(prepare(scenario.replace(uniform)))
evaluation_s = time.perf_counter() - begin
corner_m = place_m.min(axis=0)
column, line = ((place_m - corner_m) / CELL_M).astype(int).T
columns, lines = column.max() + 1, line.max() + 1
data, number = np.unique(np.concatenate([row, measured_row]), return_inverse=True)
jacobian = coo_array((power, (number[: len(row)], line * columns + column)), shape=(len(data), columns * lines)).tocsr()
profile = np.bincount(number[len(row) :], measured_power, minlength=len(data))

# Rows as shares of their own power. Weak rows, where few rays of either tracing arrive, do not count.
whole = jacobian.sum(axis=1)
strong = whole > 1e-2 * np.quantile(whole, 0.9)
lit = np.asarray(jacobian[strong].sum(axis=0)).ravel() > 0

# Neighbours are alike but for the contrast: rows of differences, in units of a typical gamma.
typical = profile[strong].sum() / whole[strong].sum()
scale = diags_array(1 / (NOISE * typical * whole[strong]))


def differences(count):
    """Return the matrix of differences between neighbours."""
    return diags_array([-np.ones(count - 1), np.ones(count - 1)], offsets=[0, 1], shape=(count - 1, count))


smooth = vstack(
    [kron(eye_array(lines), differences(columns)), kron(differences(lines), eye_array(columns))], format="csr"
)
system = vstack([typical * (scale @ jacobian[strong]), smooth / CONTRAST], format="csr")
right = np.concatenate([scale @ profile[strong], np.zeros(smooth.shape[0])])
normal = (system.T @ system).tocsr()
solved, unfinished = cg(normal, system.T @ right, rtol=1e-6, M=diags_array(1 / normal.diagonal()))
assert unfinished == 0
gamma = typical * solved
solve_s = time.perf_counter() - begin

unknowns = int(lit.sum())
quotients_s = evaluation_s * unknowns
faster = quotients_s / solve_s
print(f"{unknowns:,} cells from {strong.sum():,} powers, {jacobian.nnz:,} derivatives")
print(f"traced in {evaluation_s:.1f} s, solved in {solve_s:.1f} s in all; difference quotients: {quotients_s:,.0f} s")
print(f"{faster:,.0f} times faster than difference quotients; a tenth of the unknowns is {unknowns / 10:,.0f}")

# %%
# Against the truth: the strong field is north of the track.
shown = np.where(lit, gamma, np.nan).reshape(lines, columns)
north_m = corner_m[1] + (np.arange(lines) + 0.5) * CELL_M
with np.errstate(invalid="ignore"):
    gamma_db = 10 * np.log10(np.maximum(shown, 1e-6))
for name, side, truth_db in (("strong", north_m > 3.0, -25.0), ("weak", north_m < -3.0, -28.0)):
    error_db = gamma_db[side] - truth_db
    median, spread = np.nanmedian(error_db), np.nanpercentile(np.abs(error_db), 68)
    print(f"{name} field: median error {median:+.2f} dB, 68 % of the cells within {spread:.2f} dB")

# %%
figure = Figure(figsize=(8.0, 5.6), layout="constrained")
axes = figure.subplots()
east_m, top_m = corner_m[0] + columns * CELL_M, corner_m[1] + lines * CELL_M
extent = (corner_m[0], east_m, corner_m[1], top_m)
image = axes.imshow(gamma_db, origin="lower", extent=extent, vmin=-31.0, vmax=-22.0, cmap="viridis")
figure.colorbar(image, ax=axes, label="gamma (dB)")
axes.axhline(0.0, color="white", lw=0.8, ls="--")
axes.set(xlabel="East (m)", ylabel="North (m)", title=f"{unknowns:,} cells in {solve_s:.0f} s")
figure.savefig("sigma0_per_cell.png", dpi=90)
