"""
Paper Fig. 8 and 9: a beam on a roof edge
=========================================

From 30 m above the ground the beam lights the far edge of a roof and the ground behind it. One chirp holds both: two
detections near 36.4 m and 44.0 m.
"""

# %%
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from sionna_radar import load_scenario, prepare, run
from sionna_radar.report import colour_bar, finish_map

BLUE, ORANGE, RED = "#0072b2", "#e69f00", "#d55e00"  # safe for colour-blind readers

scenario = load_scenario("roof_edge")
for ranging in ("peak", "centroid"):
    points = run(load_scenario("roof_edge", {"processing.ranging": ranging})).points
    found = [points.range_m[points.number == number] for number in (0, 1)]
    text = " and ".join(f"{np.median(r):.2f} m (spread {r.std():.2f} m)" for r in found)
    print(f"{ranging}: {text}, median of {len(np.unique(points.pulse))} chirps")
survey = run(scenario)
record = survey.chirp

# %%
# Where the rays of that chirp meet roof and ground.
prepared = prepare(scenario)
pulses = prepared.flight.pulses(np.array([record.pulse]))
paths = prepared.sensor_inputs().tracer().trace(pulses)
power = np.abs(paths.gain) ** 2
on_roof = power[paths.hit_m[:, 2] > 1.0].sum() / power.sum()
# Rays are drawn in proportion to the two-way gain and bear nearly equal powers; the gain tells the beam's shape.
ray = paths.hit_m - pulses.true.position_m
ray /= np.linalg.norm(ray, axis=1, keepdims=True)
gain_db = 20 * np.log10(
    prepared.instrument.antenna.gain(ray @ pulses.true.R_world_antenna[0]) / prepared.instrument.antenna.peak_gain
)
strong = gain_db > -20
print(f"{on_roof:.0%} of the chirp's power comes from the roof")

figure = Figure(figsize=(11.0, 7.4), layout="constrained")
section, plan, beat, spectrum = figure.subplots(2, 2, width_ratios=[1.5, 1.0]).ravel()
edge_m = 26.66
section.fill_between([16.66, edge_m], [4.74, 4.74], 0.0, color="0.8", lw=0)
section.plot([0, 16.66, 16.66, edge_m, edge_m, 45], [0, 0, 4.74, 4.74, 0, 0], color="0.35", lw=1.4)
half = np.deg2rad(scenario.radar.antenna.beamwidth_deg) / 2
incidence = np.deg2rad(scenario.radar.scan.incidence_deg)
for angle, style in ((incidence - half, ":"), (incidence, "--"), (incidence + half, ":")):
    bottom = 4.74 if np.tan(angle) * (30 - 4.74) < edge_m else 0.0
    section.plot([0, np.tan(angle) * (30 - bottom)], [30, bottom], color=RED, lw=1.2, ls=style)
section.plot([], [], color=RED, lw=1.2, ls="--", label="Beam axis")
section.plot([], [], color=RED, lw=1.2, ls=":", label="Half-power directions")
section.plot(0, 30, ls="", marker="^", ms=9, mfc=ORANGE, mec="black", label="Radar")
section.scatter(*paths.hit_m[strong][:, [0, 2]].T, c=gain_db[strong], s=9, cmap="viridis", vmin=-20, vmax=0, zorder=3)
section.set(xlabel="Distance ahead, east (m)", ylabel="Height (m)", xlim=(-2, 40), ylim=(-2, 33))
section.set_aspect("equal")
section.legend(frameon=False, loc="upper right")
section.set_title("Section along the beam", fontsize="medium")

# %%
# The footprint in plan: part on the roof, part on the ground, the strip between in the roof's shadow.
plan.fill([16.66, edge_m, edge_m, 16.66], [-10, -10, 10, 10], color="0.85", lw=0)
plan.axvline(edge_m, color="0.35", lw=1.4)
order = np.argsort(gain_db[strong])
plan.scatter(*paths.hit_m[strong][order][:, :2].T, c=gain_db[strong][order], s=10, cmap="viridis", vmin=-20, vmax=0)
finish_map(plan, (23.5, 35.0, -3.6, 3.6), "Footprint on the roof (grey) and on the ground")
colour_bar(plan, ScalarMappable(Normalize(-20, 0), "viridis"), "Two-way gain (dB)", 3.2, extend="min")

# %%
# The beat signal, and its spectrum of 1024 points with the CFAR's threshold.
exponent = int(np.floor(np.log10(np.abs(record.beat).max())))
beat.plot(1e3 * record.sample_time_s, record.beat / 10.0**exponent, color=BLUE, lw=0.7)
beat.set(xlabel="Time in the chirp (ms)", ylabel=f"Beat signal ($10^{{{exponent}}}$ rel. to transmitted)")
beat.set_title(f"Beat signal, {len(record.beat)} samples", fontsize="medium")
beat.margins(x=0)
level_db, threshold_db = 10 * np.log10(record.power), 10 * np.log10(record.threshold)
spectrum.plot(record.range_m, level_db, color=BLUE, lw=1.0, label="Spectrum")
spectrum.plot(record.range_m, threshold_db, color=ORANGE, lw=1.6, ls="--", label="CFAR threshold")
found = ", ".join(f"{r:.1f}" for r in record.echo_range_m)
echo_db = 10 * np.log10(record.echo_power)
spectrum.plot(
    record.echo_range_m, echo_db + 2, ls="", marker="v", ms=9, mfc=RED, mec="black", label=f"Detections: {found} m"
)
near = (record.range_m > 25) & (record.range_m < 65)
spectrum.set(xlabel="Range (m)", ylabel="Power (dB rel. to transmitted)", xlim=(25, 65))
spectrum.set_ylim(np.percentile(level_db[near], 2), level_db[near].max() + 22)
spectrum.set_title("Range spectrum", fontsize="medium")
spectrum.legend(loc="upper right", frameon=False, fontsize="small")
spectrum.grid(alpha=0.3)
figure.savefig("fig08_roof_edge.png", dpi=150, bbox_inches="tight")
