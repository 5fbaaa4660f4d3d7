"""
A module that does not turn beside pencil beams and a lidar
===========================================================

Modules with arrays of transmitters and receivers look straight down and map a swath by arithmetic. The same hills, from
the same flight, by pencil beams that turn, by two modules and by a lidar, in clear air and in rain::

    python examples/mimo_modules.py
"""

import sys

import numpy as np

from sionna_radar import load_scenario, run

FLIGHT = {"platform.altitude_m": 25.0, "platform.length_m": 30.0, "dem.max_gap_m": 2.0}
EXPECTED = {"processing.expected_ground.tolerance_m": 10.0}
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
    chirp, array = prepared.receiver.chirp, prepared.module
    wavelength_mm = 1e3 * chirp.wavelength_m
    if array is None:
        width_rad = prepared.antenna.beamwidths_rad[0]
        return chirp.samples * chirp.rate_hz / 1e6, 1.05 * wavelength_mm / width_rad
    frames = prepared.local.radar.array.frame_rate_hz
    return chirp.samples * array.chirps * len(array.receiver_m) * frames / 1e6, 1e3 * float(array.size_m[1])


wanted = sys.argv[1:] or list(SENSORS)
print(f"{'':30}{'air':>9}{'points':>9}{'RMSE':>7}{'stated':>8}{'p95':>7}{'filled':>8}{'Msa/s':>8}{'mm':>7}")
for name in wanted:
    for air, weather in AIR.items():
        survey = run(load_scenario("hills", FLIGHT | SENSORS[name] | weather))
        inside = np.abs(survey.dem.grid.y_m)[:, None] <= 20.0
        # The swath that all look at, beside the ends of the flight.
        swath = inside & (np.abs(survey.dem.grid.x_m + 85.0) <= 12.0)[None]
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
