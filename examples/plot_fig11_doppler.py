"""
Paper Fig. 11: Doppler
======================

One sweep cannot separate range from velocity: a range rate adds 2 f0 v / c to the beat. Its size at 14 m/s
and 30 deg is 6.2 kHz, or 5.2 m of range; it is corrected with the measured velocity, whose error remains.
"""

# %%
import numpy as np
from matplotlib.figure import Figure

from sionna_radar import load_scenario, prepare
from sionna_radar.radar import build_chirp

COLOURS = ("#000000", "#0072b2", "#009e73", "#e69f00", "#cc79a7")  # safe for colour-blind readers
STYLES = ("-", "--", "-.", (0, (6, 2)), ":")

scenario = load_scenario("hills")
chirp = build_chirp(scenario.radar)
shift_hz = abs(chirp.doppler_hz(14.0 * np.cos(np.deg2rad(30.0))))
print(f"14 m/s at 30 deg: {shift_hz / 1e3:.2f} kHz, {shift_hz / chirp.beat_per_metre_hz:.2f} m")

# %%
# What a velocity known to 0.05 m/s leaves, by the angle between the velocity and the beam.
for angle_deg in (0.0, 45.0):
    rest_mps = 0.05 * np.cos(np.deg2rad(angle_deg))
    rest_hz, rest_m = chirp.doppler_hz(rest_mps), chirp.doppler_range_m(rest_mps)
    print(f"+-0.05 m/s at {angle_deg:2.0f} deg: +-{rest_hz:.1f} Hz, +-{100 * rest_m:.2f} cm")

# %%
# The curves; an approaching target (v > 0 in the direction of the beam) reads short on an up-sweep.
speed_mps = np.linspace(-20.0, 20.0, 201)
figure = Figure(figsize=(10.5, 4.4), layout="constrained")
left, right = figure.subplots(1, 2, width_ratios=[1.25, 1.0])
for angle_deg, colour, style in zip((0, 30, 45, 60, 75), COLOURS, STYLES, strict=True):
    doppler_khz = 1e-3 * 2 * chirp.carrier_hz * speed_mps * np.cos(np.deg2rad(angle_deg)) / 299_792_458
    left.plot(speed_mps, doppler_khz, color=colour, ls=style, lw=1.6, label=f"{angle_deg} deg")
left.plot(14.0, 1e-3 * shift_hz, ls="", marker="o", ms=9, mfc="#d55e00", mec="black", zorder=5)
left.annotate(
    f"14 m/s at 30 deg:\n{shift_hz / 1e3:.1f} kHz, {shift_hz / chirp.beat_per_metre_hz:.1f} m",
    (14.0, 1e-3 * shift_hz),
    (3.0, -8.3),
    arrowprops={"arrowstyle": "->", "lw": 1.0, "shrinkB": 6},
)
left.set(xlabel="Speed of the platform (m/s)", ylabel="Doppler shift (kHz)", xlim=(-20, 20), ylim=(-11, 11))
metres = left.secondary_yaxis(
    "right", functions=(lambda k: 1e3 * k / chirp.beat_per_metre_hz, lambda m: 1e-3 * m * chirp.beat_per_metre_hz)
)
metres.set_ylabel("Shift of the range (m)")
left.legend(title="Velocity to beam", frameon=False, loc="upper left", fontsize="small")
left.set_title("Size of the Doppler shift (towards the target positive)", fontsize="medium")
left.grid(alpha=0.3)

# %%
# What remains after a correction with a velocity that is 0.05 m/s off.
angle_deg = np.linspace(0, 90, 181)
rest_cm = 100 * chirp.doppler_range_m(0.05 * np.cos(np.deg2rad(angle_deg)))
right.fill_between(angle_deg, -rest_cm, rest_cm, color="#0072b2", alpha=0.25, lw=0)
right.plot(angle_deg, rest_cm, color="#0072b2", lw=1.6)
right.plot(angle_deg, -rest_cm, color="#0072b2", lw=1.6)
for at_deg in (0.0, 45.0):
    rest_mps = 0.05 * np.cos(np.deg2rad(at_deg))
    right.plot(at_deg, 100 * chirp.doppler_range_m(rest_mps), ls="", marker="o", ms=8, mfc="#d55e00", mec="black")
    text = f"±{chirp.doppler_hz(rest_mps):.0f} Hz, ±{100 * chirp.doppler_range_m(rest_mps):.1f} cm"
    right.annotate(text, (at_deg + 3, 100 * chirp.doppler_range_m(rest_mps) + 0.1))
right.axhline(0.0, color="black", lw=0.8)
right.set(xlabel="Angle of the velocity to the beam (deg)", ylabel="Range error (cm)", xlim=(-3, 90), ylim=(-3, 3))
right.set_title("Left by a velocity known to ±0.05 m/s", fontsize="medium")
right.grid(alpha=0.3)
figure.savefig("fig11_doppler.png", dpi=150, bbox_inches="tight")

# %%
# The survey's own pulses: what their boresights see of the flight at 10 m/s.
pulses = prepare(scenario).flight.sample(180)
rate_mps = pulses.true.boresight_range_rate_mps
print(f"hills: range rates {rate_mps.min():.2f} to {rate_mps.max():.2f} m/s")
