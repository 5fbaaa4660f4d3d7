"""
What the air takes, and what it sends back
==========================================

Rain, snow, fog, haze, dust and smoke from 10 to 150 GHz: the loss of a kilometre, and the echo of a cubic metre. Below,
a beam through rain that differs from place to place: a shower halfway to the ground. The models and their sources are
in `examples/WEATHER.md`. With SIONNA_RADAR_SMALL=1 in the environment the curves are coarse.
"""

# %%
import os

import numpy as np
from matplotlib.figure import Figure

from sionna_radar import load_scenario, prepare
from sionna_radar.scenario import WeatherTable
from sionna_radar.tracing import build_weather, rain_map_of
from sionna_radar.weather import volume_of

SMALL = os.environ.get("SIONNA_RADAR_SMALL") == "1"
FREQUENCIES_HZ = np.geomspace(10e9, 150e9, 8 if SMALL else 60)
AIR = {
    "rain, 4 mm/h": ({"rain_rate_mm_per_h": 4.0}, "#0072b2", "-"),
    "wet snow, 4 mm/h": ({"snowfall_mm_per_h": 4.0, "snow": "wet"}, "#56b4e9", "-"),
    "dry snow, 4 mm/h": ({"snowfall_mm_per_h": 4.0}, "#009e73", "-"),
    "fog, seen through for 50 m": ({"fog_visibility_m": 50.0}, "#999999", "-"),
    "dust, 10 m": ({"dust_visibility_m": 10.0}, "#d55e00", "-"),
    "dust, 100 m": ({"dust_visibility_m": 100.0}, "#d55e00", "--"),
    "smoke, 100 m": ({"smoke_visibility_m": 100.0}, "#000000", ":"),
    "haze, 2 km": ({"haze_visibility_m": 2000.0}, "#e69f00", ":"),
}


# %%
# Attenuation and reflectivity of each kind of air.
def air_at(table, carrier_hz):
    """Return the loss in dB/km, and the reflectivity in dB(m2/m3)."""
    weather = build_weather(table, carrier_hz)
    loss_db_per_km = float(weather.attenuation_db_per_km(np.zeros(1))[0])
    return loss_db_per_km, 10 * np.log10(volume_of(weather).reflectivity_per_m)


figure = Figure(figsize=(12.5, 9.0), layout="constrained")
(losses, echoes), (seen, rates) = figure.subplots(2, 2)
for name, (keys, colour, style) in AIR.items():
    table = WeatherTable(temperature_k=273.15 if "snow" in name else 283.15, **keys)
    loss, echo = np.array([air_at(table, float(f)) for f in FREQUENCIES_HZ]).T
    losses.loglog(FREQUENCIES_HZ / 1e9, loss, style, color=colour, label=name)
    echoes.semilogx(FREQUENCIES_HZ / 1e9, echo, style, color=colour)
    at_77 = air_at(table, 77e9)
    print(f"{name}: {at_77[0]:.3g} dB/km and {at_77[1]:.0f} dB m2/m3 at 77 GHz")
gases = [build_weather(WeatherTable(gases=True), float(f)).gas_attenuation_db_per_km for f in FREQUENCIES_HZ]
losses.loglog(FREQUENCIES_HZ / 1e9, gases, color="#cc79a7", linewidth=1.0, label="air itself (oxygen, vapour)")
losses.set(xlabel="Frequency (GHz)", ylabel="Attenuation, one way (dB/km)", title="What the air takes", ylim=(1e-6, 60))
echoes.set(xlabel="Frequency (GHz)", ylabel="Reflectivity (dB m²/m³)", title="What it sends back", ylim=(-180, -20))
for axes in (losses, echoes):
    axes.set_xticks([10, 24, 35, 77, 94, 150], ["10", "24", "35", "77", "94", "150"])
    axes.minorticks_off()
    axes.axvline(77, color="0.8", linewidth=0.8, zorder=0)
    axes.grid(alpha=0.3)
losses.legend(fontsize="small", ncols=2, loc="lower right")

# %%
# A shower in the swath of a survey: the mean power of one scan direction, with the shower and in even rain.
SHOWER = {"centre_m": [-45.0, 10.0], "radius_m": 12.0, "peak_mm_per_h": 60.0}
FLIGHT = {
    "terrain": {"kind": "flat", "spacing_m": 4.0},
    "platform.start_m": [-80.0, 10.0],
    "platform.speed_mps": 0.1,
    "platform.length_m": 0.12,
    "radar.scan": {"mode": "fixed", "incidence_deg": 60.0},
}
KINDS = {
    "even rain, 4 mm/h": {"rain_rate_mm_per_h": 4.0},
    "4 mm/h and the shower": {"rain_rate_mm_per_h": 4.0, "rain_cell": SHOWER},
}
PULSES = 40 if SMALL else 400
for (name, keys), colour in zip(KINDS.items(), ("#56b4e9", "#d55e00"), strict=True):
    scenario = load_scenario("hills", {"weather": keys, **FLIGHT})
    prepared = prepare(scenario)
    pulses = prepared.flight.pulses(np.arange(min(PULSES, len(prepared))))
    analyser = prepared.instrument.detector.analyser
    power = analyser.power(prepared.receiver.beat(prepared.sensor_inputs().tracer().trace(pulses), pulses)).mean(axis=0)
    range_m = analyser.range_m
    level_db = 10 * np.log10(power * range_m**2 / prepared.receiver.transmit_power_w + 1e-30)
    seen.plot(range_m, level_db, color=colour, label=name)
    pose = pulses.true
    along_m = pose.position_m[0, :2] + range_m[:, None] * pose.boresight[0, :2]
    rain = rain_map_of(scenario.weather)
    rate = np.full(len(range_m), 4.0) if rain is None else rain.rate_mm_per_h(along_m)
    rates.plot(range_m, rate, color=colour, label=name)
seen.set(xlabel="Range (m)", ylabel="Mean power times range squared (dB m²)", xlim=(0, 130), ylim=(-125, -55))
seen.set_title("What a beam 60 deg off nadir hears")
rates.set(xlabel="Range (m)", ylabel="Rain rate along the beam (mm/h)", title="What it looks through", xlim=(0, 130))
for axes in (seen, rates):
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small")
figure.savefig("weather.png", dpi=110, bbox_inches="tight")
