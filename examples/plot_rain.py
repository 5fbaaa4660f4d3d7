"""
Mapping in rain
===============

How heavy may the rain be? Rain weakens the echo of the ground on its way, and sends an echo of its own from every
range in front of it. Both are simulated here from 0.1 to 150 mm/h, with the noise of a real receiver, and three ways
of processing are held against each other. With SIONNA_RADAR_SMALL=1 in the environment the study is a short one.
"""

# %%
import os
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from sionna_radar import load_scenario, run
from sionna_radar.preparation import prepare
from sionna_radar.radar.equation import plane_echo, two_way_beam_sr
from sionna_radar.sensors import build_tracer, received
from sionna_radar.tracing.atmosphere import build_atmosphere, build_weather
from sionna_radar.weather.path import rain_clutter_power, two_way_attenuation

SMALL = os.environ.get("SIONNA_RADAR_SMALL") == "1"
RATES = [1.0, 50.0] if SMALL else [0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 80.0, 150.0]
SIZE = {"platform.length_m": 60.0, "tracing.paths_per_pulse": 512}
if SMALL:
    SIZE = {"platform.length_m": 6.0, "tracing.paths_per_pulse": 64, "terrain.spacing_m": 2.0}
PROCESSING = {
    "smallest-of CFAR, centroid (default)": {"processing.ranging": "centroid"},
    "smallest-of CFAR, peak": {"processing.ranging": "peak"},
    "greatest-of CFAR, centroid": {"processing.ranging": "centroid", "processing.cfar.kind": "GO"},
}
GROUND_M = 3.0  # an echo this close to the surface on the boresight is the ground's


def in_rain(rate, **changes):
    return load_scenario("rain", {"weather.rain_rate_mm_per_h": rate, **SIZE, **changes})


# %%
# The closed forms: what rain takes from the ground's echo 71 m away, and how strong its own is in a range cell there.
figure = Figure(figsize=(11, 7.5), layout="constrained")
(spectrum_axes, budget_axes), (rms_axes, rate_axes) = figure.subplots(2, 2)
ready = prepare(in_rain(0.0))
antenna, chirp = ready.antenna, ready.chirp
ground = ready.built.scene.materials["ground"]
slant_m = 50.0 / np.cos(np.deg2rad(45))
clear_echo = plane_echo(antenna, ground, chirp.wavelength_m, 50.0, np.deg2rad(45))
footprint_cells = slant_m * np.deg2rad(2.0) / chirp.range_resolution_m  # tan 45 deg = 1


def clutter(rate, edges_m):
    weather = build_weather(in_rain(rate).weather, chirp.carrier_hz)
    return rain_clutter_power(
        edges_m,
        reflectivity_per_m=weather.rain_reflectivity_per_m,
        two_way_beam_sr=two_way_beam_sr(antenna),
        peak_gain=antenna.peak_gain,
        wavelength_m=chirp.wavelength_m,
        specific_attenuation_db_per_km=loss_db_per_km(rate),
    )


def loss_db_per_km(rate):
    looking_down = ready.schedule.sample(1).true
    atmosphere = build_atmosphere(in_rain(rate).weather, antenna, chirp, 1)
    return float(atmosphere.attenuation_db_per_km(looking_down)[0])


curve = np.geomspace(0.1, 150, 40)
loss = np.array([-10 * np.log10(two_way_attenuation(np.array([slant_m]), loss_db_per_km(r))[0]) for r in curve])
cell = slant_m + np.array([-0.5, 0.5]) * chirp.range_resolution_m
near = 45.0 + np.array([-0.5, 0.5]) * chirp.range_resolution_m
for place, label in ((cell, "at the ground's range"), (near, "at 45 m, where the gate opens")):
    rain = np.array([clutter(r, place)[0] for r in curve])
    ratio = 10 * np.log10(clear_echo / footprint_cells / rain) - loss
    budget_axes.semilogx(curve, ratio, label=f"ground over rain, per range cell, {label}")
budget_axes.semilogx(curve, loss, "k--", label="two-way attenuation over 71 m")
budget_axes.axhline(0, color="0.7", linewidth=0.8)
budget_axes.set(xlabel="Rain rate (mm/h)", ylabel="dB", title="Rain takes little and gives much")
budget_axes.legend(fontsize="small")

# %%
# Spectra: mean over pulses that look ahead, with the closed form of the rain dashed (as a window sees noise).
for rate, colour in zip([0.0, 1.0, 10.0, 100.0], ("0.3", "C0", "C1", "C3"), strict=True):
    rainy = replace(ready, scenario=in_rain(rate))
    pulses = ready.schedule.sample(20 if SMALL else 200)
    ahead = ready.schedule.pulses(pulses.index[np.abs(pulses.scan_rad) < 0.3])
    beat = received(build_tracer(rainy).trace(ahead), ahead, rainy)
    power = ready.detector.spectra(beat).power.mean(axis=0) / ready.transmit_power_w
    range_m = ready.detector.analyser.range_m
    spectrum_axes.plot(range_m, 10 * np.log10(power), color=colour, linewidth=0.9, label=f"{rate:g} mm/h")
    if rate > 0:
        edges = np.arange(10, 240) * chirp.range_resolution_m
        window = ready.detector.analyser.window
        seen = clutter(rate, edges) * len(window) * np.sum(window**2)
        spectrum_axes.plot(edges[:-1], 10 * np.log10(seen), "--", color=colour, linewidth=0.9)
spectrum_axes.axvline(45, color="0.7", linewidth=0.8)
spectrum_axes.set(xlim=(3, 100), xlabel="Range (m)", ylabel="Power over sent power (dB)")
spectrum_axes.set_title("Mean spectrum looking ahead; dashed: rain, closed form")
spectrum_axes.legend(fontsize="small")

# %%
# The surveys. A pulse has detected the ground when an echo lies within 3 m of the surface on its boresight.
for name, changes in PROCESSING.items():
    rms, found = [], []
    for rate in RATES:
        scenario = in_rain(rate, **changes)
        survey = run(scenario)
        rms.append(survey.dem_error.rms_m)
        pose = ready.schedule.pulses(survey.points.pulse).true
        true_m = ready.built.caster.cast(pose.position_m, pose.boresight).distance_m
        hit = np.unique(survey.points.pulse[np.abs(survey.points.range_m - true_m) < GROUND_M])
        false = np.mean(np.abs(survey.points.range_m - true_m) >= GROUND_M) if len(true_m) else 0.0
        found.append(len(hit) / survey.pulses)
        print(
            f"{name}: {rate:g} mm/h: {rms[-1]:.2f} m RMS over {survey.dem_error.coverage:.0%} of the ground, "
            f"{found[-1]:.1%} of pulses detect it, {false:.1%} of echoes are rain"
        )
    rms_axes.loglog(RATES, rms, "o-", markersize=4, label=name)
    rate_axes.semilogx(RATES, 100 * np.array(found), "o-", markersize=4, label=name)
rms_axes.set(xlabel="Rain rate (mm/h)", ylabel="DEM error (m RMS)", title="Error of the elevation model")
rms_axes.legend(fontsize="small")
rate_axes.set(xlabel="Rain rate (mm/h)", ylabel="Pulses (%)", title="Pulses that detect the ground", ylim=(-3, 103))
figure.suptitle("Hills of the class 'mountain', 50 m up, 45 deg, 2 deg beam, 10 dBm, noise figure 15 dB")
figure.savefig("rain.png")
