"""Published ranges at which radars see obstacles, beside those of the radar equation with what their makers state.

A first row is taken as it is and gives the constant of its radar; the others follow from it. `docs/obstacles.md` holds
the table and the assumptions.
"""

import numpy as np
from scipy.constants import Boltzmann, speed_of_light

from sionna_radar.tracing import rcs_of_wire


def reach_m(snr, power_w, gain, carrier_hz, noise_figure, coherent_s, rcs_m2):
    """Return the range at which a cross-section, a function of the range, has a ratio to the noise."""
    range_m = np.geomspace(1.0, 10_000.0, 4000)
    wavelength_m = speed_of_light / carrier_hz
    rcs = np.array([rcs_m2(r) for r in range_m])
    received_w = power_w * gain**2 * wavelength_m**2 * rcs / ((4 * np.pi) ** 3 * range_m**4)
    noise_w = Boltzmann * 290 * noise_figure / coherent_s
    return float(range_m[received_w / noise_w >= snr].max())


print("24 GHz, farm drone: power lines of -10 dBsm from 30 m, so that")
for name, rcs_dbsm, stated_m in (("buildings", -5, 50), ("dry branches", -15, 20)):
    range_m = 30 * 10 ** ((rcs_dbsm + 10) / 40)
    print(f"  {name} of {rcs_dbsm} dBsm: {range_m:.1f} m, stated {stated_m} m ({range_m / stated_m - 1:+.0%})")
for diameter_m in (1.2e-3, 10e-3):
    along, across = rcs_of_wire(diameter_m, 24.15e9, 30.0)
    print(f"  a wire of {1000 * diameter_m:.1f} mm, square on, 30 m: {10 * np.log10(along):.1f} dBsm along the field")

print("60 GHz, dome of six modules: wires of 1.2 mm at up to 10 m")
for name, part in (("field along", 0), ("field across", 1)):
    range_m = reach_m(
        10**1.5, 10e-3, 10**0.5, 62e9, 10**1.2, 5e-3, lambda r, part=part: rcs_of_wire(1.2e-3, 62e9, r)[part]
    )
    print(f"  {name}: {range_m:.1f} m ({range_m / 10 - 1:+.0%})")

print("94 GHz, helicopter: 800 m (V) and 600 m (H); the difference is that of the antennas' gains")
print(f"  of an echo that falls with the third power: {15 * np.log10(800 / 600):.1f} dB of gain each way")
needed = reach_m(10**1.5, 10**-0.983, 1.0, 94e9, 10.0, 1e-3, lambda r: rcs_of_wire(22e-3, 94e9, r)[0])
print(f"  20.17 dBm, 22 mm, 1 ms, noise figure 10 dB: 800 m needs {15 * np.log10(800 / needed):.1f} dBi")
