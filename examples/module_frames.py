"""
Two frames of a real 77 GHz module beside the receiver model
============================================================

Floor and leakage of the receiver model are fitted to one frame; the other frame, which nothing was fitted to, says how
well they hold. Both are raw samples of a TI module indoors at 2.5 MS/s and 60 MHz/us, int16, ``iq``
[chirp, sample, 2] and [chirp, receiver, sample, 2] (OpenRadar's ``simple_frame_1.npy`` and ``doppler_example_1.npy``
in that form, Apache-2.0)::

    python examples/module_frames.py ti_77ghz_frame.npz ti_77ghz_frame_4rx.npz
"""

import sys
from itertools import pairwise

import numpy as np
from scipy.stats import kurtosis

from sionna_radar import load_scenario, prepare

FITTED, TESTED = (np.load(path)["iq"].astype(float) for path in sys.argv[1:3])
SPEED_MPS = 299792458.0
SAMPLING_RATE_HZ, SLOPE_HZ_PER_S, START_HZ = 2.5e6, 60e12, 77e9
TRANSMIT_DBM, NOISE_FIGURE_DB = 12.0, 15.0  # SWRS222, as in radar.preset = "ti_awr1843"
BANDS = (0, 5, 30, 60, 90, 118, 128)
LEAKAGE_CELLS = 6
# Cells where the high-pass lets pass nearly all.
PLAIN = slice(30, 90)
HIGH_PASS_HZ = 175e3  # assumed: the lowest corner that these chips offer


def complex_samples(iq):
    return iq[..., 0] + 1j * iq[..., 1]


# %%
# The scene stands still, or nearly: what differs from chirp to chirp is noise, in the half of the Doppler spectrum
# that is farthest from zero. Its median over the chirps is ln 2 times its mean.
def spectra(beat):
    window = np.hanning(beat.shape[1] + 1)[:-1]
    return np.fft.fft(beat * window / window.sum(), axis=1)


def noise_of(beat):
    slow = np.hanning(len(beat) + 1)[:-1, None]
    moving = np.abs(np.fft.fft(spectra(beat) * slow, axis=0)) ** 2 / np.sum(slow**2)
    return np.median(moving[len(beat) // 4 : 3 * len(beat) // 4], axis=0) / np.log(2)


def levels_db(power):
    return [10 * np.log10(power[first:end].mean()) for first, end in pairwise(BANDS)]


def leakage_db(beat):
    return 10 * np.log10(np.mean(np.abs(spectra(beat)[:, :LEAKAGE_CELLS]) ** 2, axis=0))


# %%
# From the first frame: the floor, and the strongest line between two cells.
fitted = complex_samples(FITTED)
samples = fitted.shape[1]
window = np.hanning(samples + 1)[:-1]
floor = noise_of(fitted)
sample_noise = floor[PLAIN].mean() * window.sum() ** 2 / np.sum(window**2)
cells = np.linspace(0.2, 3.0, 561)
waves = np.exp(2j * np.pi * np.outer(cells, np.arange(samples)) / samples)
tones = np.abs((fitted.mean(axis=0) * window) @ waves.conj().T) / window.sum()
bandwidth_hz = SLOPE_HZ_PER_S * samples / SAMPLING_RATE_HZ
cell_m = SPEED_MPS / (2 * bandwidth_hz)
leakage_m, leakage_power = cells[tones.argmax()] * cell_m, tones.max() ** 2
print(
    f"noise {np.sqrt(sample_noise):.2f} counts a sample, leakage at {leakage_m:.3f} m, "
    f"{10 * np.log10(leakage_power / sample_noise):.1f} dB over it"
)

# %%
# The same in the receiver model: over ground that returns nothing, with the published power and noise figure.
noise_dbm = -174.0 + 10 * np.log10(SAMPLING_RATE_HZ) + NOISE_FIGURE_DB
beat_hz = leakage_m / cell_m * SAMPLING_RATE_HZ / samples
passed = beat_hz**2 / (beat_hz**2 + HIGH_PASS_HZ**2)
leakage_dbm = noise_dbm + 10 * np.log10(leakage_power / sample_noise / passed)
scenario = {
    "terrain": {"kind": "flat", "size_m": [60.0, 60.0], "spacing_m": 1.0},
    "materials.ground": {"model": "constant_gamma", "gamma_db": -100.0},
    "platform": {"altitude_m": 2.0, "speed_mps": 1.0, "length_m": 0.02},
    "radar": {
        "preset": "ti_awr1843",
        "carrier_hz": START_HZ + bandwidth_hz / 2,
        "bandwidth_hz": bandwidth_hz,
        "chirp_rate_hz": SAMPLING_RATE_HZ / samples,
        "samples_per_chirp": samples,
        "receiver": {
            "high_pass_corner_hz": HIGH_PASS_HZ,
            "high_pass_order": 1,
            "leakage": [
                {
                    "delay_ns": 2e9 * leakage_m / SPEED_MPS,
                    "level_db": leakage_dbm - TRANSMIT_DBM,
                }
            ],
            "converter": {
                "bits": 16,
                "full_scale_over_noise_db": 10 * np.log10(2**30 / sample_noise),
            },
            "oscillator": {"phase_noise_preset": "ti_awr1843aop_77ghz"},
        },
    },
    "processing.cfar": {"guard": 4, "training": 8},
    "processing.min_range_m": 0.3,
    "dem.spacing_m": 0.1,
}
prepared = prepare(load_scenario("hills", scenario))
beat = prepared.beats(np.arange(len(fitted)))[0]
simulated = beat * np.sqrt(sample_noise / prepared.receiver.noise_power_w)

# %%
# The frame that nothing was fitted to, receiver by receiver.
tested = [complex_samples(TESTED)[:, receiver] for receiver in range(TESTED.shape[1])]
everything = {"fitted": fitted, "simulated": simulated} | {f"tested, receiver {n + 1}": b for n, b in enumerate(tested)}
print("floor, dB of counts squared, in the cells " + ", ".join(f"{a} to {b - 1}" for a, b in pairwise(BANDS)))
for name, values in everything.items():
    print(f"  {name:20s}" + "  ".join(f"{level:6.1f}" for level in levels_db(noise_of(values))))
print("leakage in the first cells, dB")
for name, values in everything.items():
    print(f"  {name:20s}" + "  ".join(f"{level:6.1f}" for level in leakage_db(values)))
print("samples, counts: RMS of I and Q, greatest, excess kurtosis, correlation of I and Q")
for name, values in everything.items():
    i, q = values.real.ravel(), values.imag.ravel()
    greatest = max(np.abs(i).max(), np.abs(q).max())
    print(
        f"  {name:20s}{i.std():6.1f} {q.std():6.1f} {greatest:6.0f} {kurtosis(i):6.2f} {np.corrcoef(i, q)[0, 1]:6.2f}"
    )
