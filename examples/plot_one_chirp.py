"""
One chirp through every stage
=============================

The chain taken apart: a scene, one pulse, its paths, its beat signal, its spectrum, its echoes, its points.
Each stage is a plain function or object that a script can use alone.
"""

# %%
# A scenario gives the parts; `prepare` builds the scene and the flight and refuses what cannot be flown.
import numpy as np
from matplotlib.figure import Figure

from sionna_radar import load_scenario, prepare
from sionna_radar.mapping import locate
from sionna_radar.signal import add_noise, synthesise

prepared = prepare(load_scenario("roof_edge"))
pulses = prepared.flight.pulses(np.array([0]))
print(f"{len(prepared)} pulses scheduled; the first looks along {pulses.true.boresight[0].round(3)}")

# %%
# Tracing: where the rays of the beam meet the roof and the ground, and how strongly they come back.
paths = prepared.sensor_inputs().tracer().trace(pulses)
power_db = 20 * np.log10(np.abs(paths.gain))
figure = Figure(figsize=(6, 4), layout="constrained")
axes = figure.add_subplot()
dots = axes.scatter(paths.hit_m[:, 0], paths.hit_m[:, 2], c=power_db, s=6, vmin=power_db.max() - 30)
figure.colorbar(dots, label="Path gain (dB)")
axes.set(xlabel="East (m)", ylabel="Height (m)", title="Paths of one pulse", xlim=(20, 40), ylim=(-1, 7))
figure.savefig("paths.png")

# %%
# Synthesis: every path adds a tone at its range; noise follows.
clean = synthesise(paths, pulses, prepared.receiver.chirp)
beat = add_noise(clean, prepared.receiver.noise_power_w, prepared.scenario.seed, pulses.index)
figure = Figure(figsize=(6, 3), layout="constrained")
axes = figure.add_subplot()
axes.plot(1e3 * prepared.receiver.chirp.sample_time_s, 1e6 * beat[0], linewidth=0.7)
axes.set(xlabel="Time in the chirp (ms)", ylabel="Beat signal (1e-6)", title="Beat signal")
figure.savefig("beat.png")

# %%
# Detection: spectrum, CFAR threshold, echoes with their range corrected for Doppler.
spectra = prepared.instrument.detector.spectra(beat)
echoes = prepared.instrument.detector.echoes(spectra, pulses.index, pulses.measured)
figure = Figure(figsize=(6, 3), layout="constrained")
axes = figure.add_subplot()
range_m = prepared.instrument.detector.analyser.range_m
axes.plot(range_m, 10 * np.log10(spectra.power[0]), linewidth=0.8, label="spectrum")
axes.plot(range_m, 10 * np.log10(spectra.threshold[0]), linewidth=0.8, label="CFAR threshold")
axes.plot(echoes.range_m, 10 * np.log10(echoes.power), "v", label="echoes")
axes.set(xlabel="Range (m)", ylabel="Power (dB)", title="Two echoes: roof and ground", xlim=(20, 60))
axes.legend()
figure.savefig("spectrum.png")

# %%
# Mapping: each echo is placed on the beam axis, from the pose that the navigation system measured.
points = locate(echoes, pulses.index, pulses.measured)
for number, position in zip(points.number, points.position_m, strict=True):
    print(f"echo {number}: {points.range_m[number]:.2f} m away, placed at {position.round(2)}")
