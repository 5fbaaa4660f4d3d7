"""
A real 77 GHz module, processed like a simulated flight
=======================================================

The raw capture of a real FMCW module becomes a recording in the layout that ``sionna-radar process`` reads, goes
through the same spectrum, CFAR and ranging as a simulated survey, and is shown beside a simulated chirp of the same
settings.

The capture is an ``.npz`` with ``iq``, int16 [chirp, sample, 2], of a TI module at 2.5 MS/s and 60 MHz/us (OpenRadar's
``simple_frame_1.npy`` in that form, Apache-2.0)::

    python examples/real_recording.py ti_77ghz_frame.npz
"""

import sys
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from sionna_radar import load_scenario, process, run

CAPTURE = Path(sys.argv[1])
SAMPLING_RATE_HZ, SLOPE_HZ_PER_S, START_HZ = 2.5e6, 60e12, 77e9
# The first cells hold the leakage from transmitter to receiver.
LEAKAGE_CELLS = 3

# %%
# The layout: samples, what the sweep was, and nothing else. Only the sampled part of the sweep counts.
iq = np.load(CAPTURE)["iq"]
chirps, samples = iq.shape[:2]
bandwidth_hz = SLOPE_HZ_PER_S * samples / SAMPLING_RATE_HZ
carrier_hz = START_HZ + bandwidth_hz / 2
layout = xr.Dataset(
    {"beat_i": (("pulse", "sample"), iq[..., 0]), "beat_q": (("pulse", "sample"), iq[..., 1])},
    attrs={"carrier_hz": carrier_hz, "bandwidth_hz": bandwidth_hz, "sampling_rate_hz": SAMPLING_RATE_HZ},
)
layout.to_netcdf("real.nc", engine="h5netcdf")

# %%
# A sweep of 128 samples has 128 range cells: the CFAR's windows must be shorter.
SETTINGS = {"processing.cfar.guard": 4, "processing.cfar.training": 8, "processing.min_range_m": 0.2}
real = process("real.nc", SETTINGS)

# %%
# A simulated chirp of the same settings: the module's antenna and noise figure, 2 m over bare ground with a reflector
# of a tenth of a square metre.
SCENE = {
    "terrain": {"kind": "flat", "size_m": [40.0, 40.0], "spacing_m": 1.0},
    "platform.altitude_m": 2.0,
    "platform.speed_mps": 1.0,
    "platform.start_m": [0.0, 0.0],
    "platform.length_m": chirps * samples / SAMPLING_RATE_HZ,
    "radar": {
        "preset": "ti_awr1843",
        "carrier_hz": carrier_hz,
        "bandwidth_hz": bandwidth_hz,
        "chirp_rate_hz": SAMPLING_RATE_HZ / samples,
        "samples_per_chirp": samples,
    },
    "targets": [{"position_m": [1.2, 0.0], "height_m": 0.05, "rcs_dbsm": -10.0}],
    "dem.spacing_m": 0.1,
}
Path("simulated.nc").unlink(missing_ok=True)
run(load_scenario("hills", SCENE | SETTINGS), recordings={"signals": "simulated.nc"})
simulated = process("simulated.nc")


# %%
# Leakage and floor, in numbers: each against the floor of its own recording, as the module is not calibrated.
def levels_db(processed):
    spectrum = processed.spectrum
    mean_db = 10 * np.log10(spectrum.mean / spectrum.floor)
    near = spectrum.range_m < LEAKAGE_CELLS * processed.sweeps[0].range_resolution_m
    return spectrum.range_m, mean_db, mean_db[near].max(), mean_db[~near].max()


figure = Figure(figsize=(11.0, 6.5), layout="constrained")
(signal, spectrum), (signal_2, spectrum_2) = figure.subplots(2, 2)
for name, processed, left, right in (
    ("real module", real, signal, spectrum),
    ("simulated", simulated, signal_2, spectrum_2),
):
    range_m, mean_db, leakage_db, strongest_db = levels_db(processed)
    floor_db = 10 * np.log10(processed.spectrum.floor)
    words = f"leakage {leakage_db:.1f} dB, strongest echo {strongest_db:.1f} dB over the floor of {floor_db:.1f} dB"
    print(f"{name}: {len(processed.time_s)} chirps, {len(processed.echoes)} echoes; {words}")
    record = processed.chirp
    left.plot(1e6 * record.sample_time_s, record.beat.real, lw=0.9, label="I")
    left.plot(1e6 * record.sample_time_s, record.beat.imag, lw=0.9, label="Q")
    left.set(title=f"Beat signal, {name}", xlabel="Time in the sweep (us)", ylabel="As recorded")
    left.legend(frameon=False, loc="upper right")
    chirp_db = 10 * np.log10(record.power / processed.spectrum.floor)
    threshold_db = 10 * np.log10(record.threshold / processed.spectrum.floor)
    right.plot(range_m, chirp_db, lw=0.6, color="0.6", label=f"Chirp {record.pulse}")
    right.plot(range_m, mean_db, lw=1.3, label="Mean of the chirps")
    right.plot(range_m, threshold_db, lw=1.0, ls="--", label="CFAR threshold")
    right.axhline(0.0, color="black", lw=0.8, ls=":", label="Noise floor")
    right.axvspan(
        0.0, LEAKAGE_CELLS * processed.sweeps[0].range_resolution_m, color="tab:red", alpha=0.12, label="Leakage"
    )
    right.set(title=f"Range spectrum, {name}", xlabel="Range (m)", ylabel="Power over the floor (dB)", ylim=(-25, 70))
    right.margins(x=0)
    right.legend(frameon=False, loc="upper right", ncols=2, fontsize="small")
figure.savefig("real_recording.png", dpi=150)
