"""
A custom antenna and scan
=========================

The antenna is two measured cuts, here a beam with a shoulder on one side; the scan is any object with the
properties and methods of `Scan`, here one that nods fore and aft while the platform moves.
"""

# %%
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from sionna_radar import CustomParts, load_scenario, run
from sionna_radar.flight import Pointing, whisk_broom_from_antenna
from sionna_radar.radar import Antenna, measured_cut

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
    period_s: float = 0.25

    @property
    def incidence_rad(self):
        """Angle from nadir in the middle of the swing: what radar.snr_db refers to."""
        return (self.least_rad + self.greatest_rad) / 2

    def point(self, time_s):
        """Return the antenna's axes in forward-right-down components."""
        swing = 0.5 - 0.5 * np.cos(2 * np.pi * time_s / self.period_s)
        tilt = self.least_rad + (self.greatest_rad - self.least_rad) * swing
        axes = np.concatenate([whisk_broom_from_antenna(float(t), np.zeros(1)) for t in tilt])
        return Pointing(axes, tilt, np.ones(len(time_s), dtype=bool))

    def spacing_m(self, height_m, speed_mps, chirp_rate_hz):
        """Return the widest gap on level ground: where the swing is fastest, or what is flown in a period."""
        rate_rad_s = np.pi / self.period_s * (self.greatest_rad - self.least_rad)
        step_m = height_m * rate_rad_s / chirp_rate_hz / np.cos(self.greatest_rad) ** 2
        return float(max(step_m, speed_mps * self.period_s))


# %%
scenario = load_scenario("hills", {"platform.length_m": 20.0})
survey = run(scenario, parts=CustomParts(antenna=antenna, scan=NoddingScan()))
print(f"{survey.pulses} pulses, {len(survey.points)} echoes")
figure = Figure(figsize=(6, 3), layout="constrained")
axes = figure.add_subplot()
position = survey.points.position_m
dots = axes.scatter(position[:, 0], position[:, 2], c=survey.points.echo_snr_db, s=4)
figure.colorbar(dots, label="SNR (dB)")
axes.set(xlabel="East (m)", ylabel="Height (m)", title="A profile under the track")
figure.savefig("custom_scan.png")
