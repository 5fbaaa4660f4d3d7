"""
A module that does not turn beside pencil beams and a lidar
===========================================================

Modules with arrays of transmitters and receivers look straight down and map a swath by arithmetic. The same ground,
from the same flight, by pencil beams that turn, by two modules and by a lidar, in clear air and in rain, over hills,
buildings or San Francisco::

    python examples/mimo_modules.py
    python examples/mimo_modules.py buildings "2 deg" module
"""

import sys

import numpy as np

from sionna_radar import load_scenario, run

# Middle, heading and length of a track, height over ground, how far from it ground is expected, and all else of it.
LINE = {"count": 1, "spacing_m": 50.0, "length_m": 60.0, "centre_m": [300.0, 30.0], "crossing": False}
TRACKS = {
    "hills": ((-85.0, 0.0), 90.0, 30.0, 25.0, 10.0, {"platform.length_m": 30.0}),
    "buildings": ((5.0, 0.0), 90.0, 70.0, 25.0, 15.0, {"platform.length_m": 70.0, "platform.start_m": [-30.0, 0.0]}),
    "san_francisco": ((300.0, 30.0), 85.0, 60.0, 40.0, 15.0, {"platform.lines": LINE}),
}
scene = sys.argv[1] if len(sys.argv) > 1 and sys.argv[1] in TRACKS else "hills"
middle_m, heading_deg, length_m, height_m, tolerance_m, flight = TRACKS[scene]
FLIGHT = flight | {"platform.altitude_m": height_m, "dem.max_gap_m": 2.0, "dem.method": "linear"}
EXPECTED = {"processing.expected_ground.tolerance_m": tolerance_m}
POWER = {"transmit_power_dbm": 12.0, "noise_figure_db": 15.0, "bandwidth_hz": 400e6}
# Beams cross the swath as far out as the modules' view.
SCAN = {"incidence_deg": 0.0, "half_swath_deg": 45.0, "rotation_rpm": 300.0}


def pencil(width_deg):
    return {"radar": {**POWER, "chirp_rate_hz": 1000.0, "antenna": {"beamwidth_deg": width_deg}, "scan": SCAN}}


def module(preset, **array):
    array = {"chirps": 32, "frame_rate_hz": 5.0, "half_view_deg": 45.0, **array}
    return {"sensor": "mimo", "radar": {"preset": preset, "array": array}, "tracing.paths_per_pulse": 8000, **EXPECTED}


SENSORS = {f"pencil beam, {width:g} deg": pencil(width) for width in (1.0, 2.0, 4.0, 8.0)}
SENSORS["3 x 4 module, in turns"] = module("ti_awr1843_array")
SENSORS["3 x 4 module, binary phases"] = module("ti_awr1843_array", multiplexing="bpm")
SENSORS["12 x 16 cascade, in Doppler"] = module("ti_awr2243_cascade")
SENSORS["lidar"] = pencil(1.0) | {"sensor": "lidar", "lidar": {"range_noise_m": 0.03, "wavelength_nm": 905}}
AIR = {"clear": {}, "4 mm/h": {"weather.rain_rate_mm_per_h": 4.0}, "10 mm/h": {"weather.rain_rate_mm_per_h": 10.0}}


# %%
# What a map is worth: its error, what it states of it, how much of the swath it fills, and the samples that it takes.
def size_of(survey):
    """Return megasamples a second on average, and the aperture across the track in millimetres."""
    prepared = survey.prepared
    if prepared.local.sensor == "lidar":
        return prepared.local.radar.chirp_rate_hz / 1e6, 20.0
    chirp, array = prepared.receiver.chirp, prepared.instrument.module
    wavelength_mm = 1e3 * chirp.wavelength_m
    if array is None:
        width_rad = prepared.instrument.antenna.beamwidths_rad[0]
        return chirp.samples * chirp.rate_hz / 1e6, 1.05 * wavelength_mm / width_rad
    frames = prepared.instrument.pulse_rate_hz
    return chirp.samples * array.chirps * len(array.receiver_m) * frames / 1e6, 1e3 * float(array.size_m[1])


def in_swath(grid):
    """Return the cells that all look at: 0.8 heights to either side, and not at the ends of the flight."""
    east, north = np.sin(np.deg2rad(heading_deg)), np.cos(np.deg2rad(heading_deg))
    x, y = np.meshgrid(grid.x_m - middle_m[0], grid.y_m - middle_m[1])
    along, across = x * east + y * north, y * east - x * north
    return (np.abs(along) <= length_m / 2 - 3.0) & (np.abs(across) <= 0.8 * height_m)


words = [word for word in sys.argv[1:] if word != scene]
wanted = [name for name in SENSORS if not words or any(word in name for word in words)]
print(f"{'':30}{'air':>9}{'points':>9}{'RMSE':>7}{'stated':>8}{'p95':>7}{'filled':>8}{'Msa/s':>8}{'mm':>7}")
for name in wanted:
    for air, weather in AIR.items():
        survey = run(load_scenario(scene, FLIGHT | SENSORS[name] | weather))
        swath = in_swath(survey.dem.grid)
        error = np.where(swath, survey.error.height_m, np.nan)
        error = error[np.isfinite(error)]
        stated = survey.dem_sigma.height_m[swath] if survey.dem_sigma is not None else np.array([np.nan])
        samples, aperture = size_of(survey)
        scatter, worst = (np.sqrt(np.mean(error**2)), np.quantile(np.abs(error), 0.95)) if len(error) else (np.nan,) * 2
        print(
            f"{name:30}{air:>9}{len(survey.points):>9,}{scatter:>7.2f}{np.sqrt(np.nanmean(stated**2)):>8.2f}{worst:>7.2f}"
            f"{len(error) / np.count_nonzero(swath):>8.0%}{samples:>8.2f}{aperture:>7.0f}",
            flush=True,
        )
