"""
Does it see the wire in time?
=============================

A drone flies toward a power line of three conductors, its radar looking ahead. Of many passes, each at another angle to
the line, those count in which the first report of an obstacle leaves enough way to stop. The table of
`docs/obstacles.md` is made by this script; with SIONNA_RADAR_SMALL=1 it flies a few short passes.
"""

# %%
import os

import numpy as np
from matplotlib.figure import Figure

from sionna_radar import load_scenario, run, sweep

SMALL = os.environ.get("SIONNA_RADAR_SMALL") == "1"
SHORT = {"platform.start_m": [-70.0, 0.0], "platform.length_m": 85.0} if SMALL else {}

# %%
# One pass: what was seen of the line and of its poles, and from how far.
survey = run(load_scenario("power_line", SHORT))
for seen in survey.obstacles.seen:
    print(f"{seen.name:18} {seen.hidden_by or f'first heard from {seen.first_range_m:.0f} m'}")
print({name: round(value, 2) for name, value in survey.obstacles.rates().items()})

# %%
# Passes at angles up to 10 deg from square to the line. `warning_s` is the time between the first report and reaching
# the obstacle at 10 m/s, and so, times that speed, the way that was left.
HEADINGS_DEG = [90.0, 97.0] if SMALL else np.round(np.linspace(80.0, 100.0, 15), 1).tolist()
CASES = {
    "beam of 3 deg": {},
    "beam of 2 deg": {"radar.antenna.beamwidth_deg": 2.0},
    "beam of 5 deg": {"radar.antenna.beamwidth_deg": 5.0},
    "10 turns a second": {"radar.scan.rotation_rpm": 599.0},
    "from 30 m": {"platform.altitude_m": 30.0},
    "smooth wires": {"wires.0.strands": None, "wires.0.lay_mm": None},
    "rain of 10 mm/h": {"weather.rain_rate_mm_per_h": 10.0},
    "rain of 20 mm/h": {"weather.rain_rate_mm_per_h": 20.0},
}
WIRES = load_scenario("power_line").model_dump(exclude_none=True)["wires"]
passes = {}
for name, changes in list(CASES.items())[: 2 if SMALL else None]:
    if name == "smooth wires":
        changes = {"wires": [{key: value for key, value in WIRES[0].items() if key not in ("strands", "lay_mm")}]}
    flown = sweep("power_line", {"platform.heading_deg": HEADINGS_DEG}, overrides=SHORT | changes)
    passes[name] = [trial for case in flown.cases for trial in case.trials]
    print(f"{name}: {len(passes[name])} passes flown", flush=True)

# %%
# Braking at 4 m/s2 after half a second takes the way v t + v^2 / 2 a.
SPEEDS_MPS, REACTION_S, BRAKING_MPS2 = np.linspace(2.0, 25.0, 93), 0.5, 4.0
needed_m = SPEEDS_MPS * REACTION_S + SPEEDS_MPS**2 / (2 * BRAKING_MPS2)
figure = Figure(figsize=(7.0, 4.2), layout="constrained")
axes = figure.subplots()
for name, trials in passes.items():
    left_m = 10.0 * np.array([trial.warning_s for trial in trials])
    share = np.mean(left_m[:, None] >= needed_m, axis=0)
    axes.plot(SPEEDS_MPS, 100 * share, label=name)
    surest = SPEEDS_MPS[share >= 0.99].max(initial=0.0)
    print(
        f"{name:18} wire reported in {np.mean([t.pd_wire for t in trials]):4.0%} of {len(trials)} passes, way left "
        f"{np.median(left_m):4.0f} m (least {left_m.min():4.0f}), stops from {surest:4.1f} m/s, "
        f"{np.mean([t.false_alarms_per_minute for t in trials]):.2f} false a minute"
    )
axes.set(xlabel="Speed (m/s)", ylabel="Passes that stop in time (%)", ylim=(-3, 103))
axes.legend(frameon=False)
axes.grid(alpha=0.3)
figure.savefig("warning_time.png", dpi=120)
