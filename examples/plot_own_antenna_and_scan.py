"""
A custom antenna and scan
=================================

The antenna is two measured cuts, here a beam with a shoulder on one side; the scan is any object with a `point`
method, here one that nods fore and aft while the platform moves.
"""

# %%
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from sionna_radar import load_scenario, run
from sionna_radar.flight.frames import whisk_broom_from_antenna
from sionna_radar.flight.scan import Pointing
from sionna_radar.radar.antenna import Antenna, measured_cut

# %%
# Two cuts against the angle from boresight: a 3 deg beam, the azimuth one with a shoulder 6 deg to the left.
angle_deg = np.linspace(-40, 40, 1601)
main_lobe_db = -12 * (angle_deg / 3.0) ** 2
shoulder_db = -18 - 12 * ((angle_deg - 6.0) / 3.0) ** 2
azimuth_db = 10 * np.log10(10 ** (main_lobe_db / 10) + 10 ** (shoulder_db / 10))
floor_db = -45.0
antenna = Antenna(
    measured_cut(np.deg2rad(angle_deg), np.maximum(azimuth_db, floor_db)),
    measured_cut(np.deg2rad(angle_deg), np.maximum(main_lobe_db, floor_db)),
)
print(f"peak gain {10 * np.log10(antenna.peak_gain):.1f} dB, beam {np.rad2deg(antenna.beamwidths_rad).round(2)} deg")


# %%
@dataclass(frozen=True)
class NoddingScan:
    """A beam that swings between two angles from nadir, four times a second."""

    least_rad: float = np.deg2rad(10.0)
    greatest_rad: float = np.deg2rad(50.0)
    stabilised: bool = True

    def point(self, time_s):
        """Return the antenna's axes in forward-right-down components."""
        swing = 0.5 - 0.5 * np.cos(2 * np.pi * 4.0 * time_s)
        tilt = self.least_rad + (self.greatest_rad - self.least_rad) * swing
        axes = np.concatenate([whisk_broom_from_antenna(float(t), np.zeros(1)) for t in tilt])
        return Pointing(axes, tilt, np.ones(len(time_s), dtype=bool))


# %%
scenario = load_scenario("hills", {"platform.length_m": 20.0, "dem.max_gap_m": 5.0})
survey = run(scenario, antenna=antenna, scan=NoddingScan())
print(f"{survey.pulses} pulses, {len(survey.points)} echoes")
figure = Figure(figsize=(6, 3), layout="constrained")
axes = figure.add_subplot()
position = survey.points.position_m
dots = axes.scatter(position[:, 0], position[:, 2], c=survey.points.snr_db, s=4)
figure.colorbar(dots, label="SNR (dB)")
axes.set(xlabel="East (m)", ylabel="Height (m)", title="A profile under the track")
figure.savefig("own_scan.png")
