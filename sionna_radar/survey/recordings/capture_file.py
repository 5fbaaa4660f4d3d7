"""The raw layout of Texas Instruments' capture card (DCA1000), with its chirp configuration.

The card writes 16-bit numbers, little-endian, chirp by chirp; in a chirp receiver by receiver, complex samples in pairs
as I, I, Q, Q (two lanes: xWR16xx, xWR18xx, xWR68xx); on four lanes (xWR12xx, xWR14xx) sample by sample, the I of all
receivers and then their Q (TI application report SWRA581B, "Mmwave Radar Device ADC Raw Data Capture"). Frames of an
array are written for two lanes. The configuration (.cfg) is that of the mmWave SDK; it holds one `chirpCfg` for each
chirp of a block. Real samples are written as they come.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Inexact, Int, Num

from sionna_radar.foundation.errors import InputFileError, OutputError
from sionna_radar.foundation.input_file import read_text, shown
from sionna_radar.foundation.numerics import spread_indices
from sionna_radar.radar.chirp import Chirp
from sionna_radar.radar.mimo_array import MimoArray

SUFFIX = ".bin"
# Noise of a sample, in counts of the converter: that of a module's frames indoors (docs/checks/module.md).
NOISE_COUNTS = 7.0
LARGEST_COUNT = 32767
# Coherence of cells with those of the negative frequencies from which samples are in the wrong order: of noise it is
# 0.9 over the root of the chirps. Chirps for it, at least and at most; cells at either end that hold leakage.
MIN_MIRRORED = 0.1
MIN_CHIRPS, MAX_CHIRPS, NEAR_CELLS = 128, 512, 4


def is_capture(path: Path) -> bool:
    """Return True if a recording is named as a raw capture."""
    return path.suffix.lower() == SUFFIX


def files_of(kind: str, path: Path) -> list[Path]:
    """Return the files of a recording: of a raw capture also its configuration, and all but its samples in netCDF."""
    return [path, *(path.with_suffix(end) for end in (".cfg", ".nc") if kind == "cube" and is_capture(path))]


class Capture:
    """A raw capture that grows, with its configuration beside it: a function of `per_count`, sqrt(W) of one count.

    noise_power_w: of each part of a sample.
    """

    def __init__(self, path: Path, noise_power_w: float, config: Callable[[float], str]) -> None:
        self.name, self.per_count = path.name, float(np.sqrt(noise_power_w)) / NOISE_COUNTS
        path.with_suffix(".cfg").write_text(config(self.per_count), encoding="ascii")
        self._file = path.open("wb")

    def write(self, index: Int[np.ndarray, " frame"], frames: Inexact[np.ndarray, "frame chirp rx sample"]) -> None:
        """Append frames of these numbers; OutputError for one beyond 16 bits."""
        for number, frame in zip(index, frames, strict=True):
            counts = raw_counts(frame / self.per_count)
            if (most := int(np.abs(counts).max(initial=0))) > LARGEST_COUNT:
                message = f"frame {number} reaches {most} counts, and 16 bits hold {LARGEST_COUNT}; record netCDF"
                raise OutputError(message)
            self._file.write(counts.astype("<i2").tobytes())

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def raw_counts(frame: Inexact[np.ndarray, "chirp rx sample"]) -> Int[np.ndarray, " value"]:
    """Return the numbers of a frame in the order of a capture, in counts.

    Two lanes: in each receiver's chirp in-phase parts of two samples, then their quadrature parts.
    """
    if not np.iscomplexobj(frame):
        return np.rint(frame).astype(np.int64).ravel()
    pairs = frame.reshape(*frame.shape[:2], -1, 1, 2)
    return np.rint(np.concatenate([pairs.real, pairs.imag], axis=3)).astype(np.int64).ravel()


CONFIG_REMEDY = "name the chirp configuration of the capture, a .cfg or .mmwave.json file"


@dataclass(frozen=True, kw_only=True)
class CaptureConfig:
    """The chirp configuration of a capture: GHz, MHz/us, us, ksps and ms as its files state them.

    frames: stated number; 0 for any.
    """

    receivers: int
    complex_samples: bool
    start_ghz: float
    slope_mhz_us: float
    idle_us: float
    adc_start_us: float
    ramp_end_us: float
    samples: int
    rate_ksps: float
    transmitters: tuple[int, ...]
    loops: int
    frame_ms: float
    frames: int


def capture_frames(path: Path, config: CaptureConfig) -> Int[np.ndarray, "frame chirp value"]:
    """Return the raw values of all chirps, mapped into memory; InputFileError where a frame is not whole."""
    values = config.receivers * config.samples * (2 if config.complex_samples else 1)
    chirps, size = len(config.transmitters) * config.loops, path.stat().st_size
    if size == 0 or size % (2 * values * chirps):
        wanted = f"a frame of its configuration {2 * values * chirps:,}"
        raise InputFileError(f"{shown(path)}: holds {size:,} bytes, and {wanted}; get the whole file")
    return np.memmap(path, dtype="<i2", mode="r").reshape(-1, chirps, values)


def receiver_samples(
    raw: Int[np.ndarray, "*chirp value"], config: CaptureConfig, lanes: int = 2, receiver: int | None = None
) -> Num[np.ndarray, "*chirp_receiver sample"]:
    """Return the samples of a receiver, counted from 0, in the raw values of chirps, or those of all of them."""
    at, (receivers, samples) = raw.shape[:-1], (config.receivers, config.samples)
    own = slice(None) if receiver is None else receiver
    if not config.complex_samples:
        values = (
            raw.reshape(*at, samples, receivers).swapaxes(-1, -2) if lanes == 4 else raw.reshape(*at, receivers, -1)
        )
        return values[..., own, :]
    if lanes == 4:
        pairs = np.moveaxis(raw.reshape(*at, samples, 2, receivers), (-1, -3), (-3, -1))[..., own, :, :]
    else:
        pairs = raw.reshape(*at, receivers, samples // 2, 2, 2).swapaxes(-3, -2)[..., own, :, :, :]
        pairs = pairs.reshape(*pairs.shape[:-3], 2, samples)
    # Single precision holds 16 bits exactly.
    return pairs[..., 0, :].astype(np.complex64) + 1j * pairs[..., 1, :].astype(np.float32)


def told_lanes(raw: Int[np.ndarray, "frame chirp value"], config: CaptureConfig, lanes: int) -> int:
    """Return the other number of lanes where only with it complex echoes have no mirror image in I and Q; else `lanes`.

    Read in the wrong order, an echo of the amplitude s stands at a frequency as a s and at its negative as b s*: the
    product of the two has one phase in all chirps, and that of independent echoes has none. The mean over chirps is
    taken out, and with it what stands still, whose product has one phase, too.
    """
    chirps = raw[:, :: len(config.transmitters)].reshape(-1, raw.shape[-1])
    if not config.complex_samples or len(chirps) < MIN_CHIRPS:
        return lanes
    chosen = chirps[spread_indices(MAX_CHIRPS, len(chirps))]

    def mirrored(order: int) -> float:
        samples = receiver_samples(chosen, config, order, 0).astype(np.complex128)
        cells = np.fft.fft((samples - samples.mean(axis=0)) * np.hanning(config.samples))[
            :, NEAR_CELLS : 1 - NEAR_CELLS
        ]
        power = np.sum(np.abs(cells) ** 2, axis=0)
        total = np.maximum(power, power[::-1]).sum()
        return float(np.abs(np.sum(cells * cells[:, ::-1], axis=0)).sum() / total) if total > 0 else 0.0

    return 6 - lanes if mirrored(lanes) > MIN_MIRRORED >= mirrored(6 - lanes) else lanes


def read_frames(samples: Path, config: Path) -> Num[np.ndarray, "frame chirp rx sample"]:
    """Return the frames of a raw capture of two lanes, of all transmitters and receivers, in counts.

    Raises InputFileError for files that cannot be read.
    """
    known = capture_config(config)
    return receiver_samples(capture_frames(samples, known), known)


def capture_config(path: Path) -> CaptureConfig:
    """Return the configuration of a capture; InputFileError for one that lacks a value, with its name."""
    text = read_text(path, "recording.config =", CONFIG_REMEDY)
    try:
        config = _from_json(json.loads(text)) if text.lstrip().startswith("{") else _from_lines(text)
    except KeyError as error:
        raise InputFileError(f"{shown(path)}: has no {error.args[0]}") from None
    except (ValueError, TypeError, IndexError) as error:
        raise InputFileError(f"{shown(path)}: cannot be read as a chirp configuration ({error})") from None
    if not np.isfinite([value for value in vars(config).values() if isinstance(value, float)]).all():
        raise InputFileError(f"{shown(path)}: states a number that is not finite")
    positive = (config.receivers, config.samples, config.rate_ksps, config.loops, len(config.transmitters))
    if min(positive) <= 0 or config.slope_mhz_us == 0 or (config.complex_samples and config.samples % 2):
        reason = "states no receiver, sample, rate, loop, chirp or slope, or an odd number of complex samples"
        raise InputFileError(f"{shown(path)}: {reason}")
    return config


def _from_lines(text: str) -> CaptureConfig:
    commands: dict[str, list[list[float]]] = {}
    for line in text.splitlines():
        words = line.split("%")[0].split()
        if words and words[0] in ("channelCfg", "adcCfg", "profileCfg", "chirpCfg", "frameCfg"):
            commands.setdefault(words[0], []).append([float(word) for word in words[1:]])
    channel, adc, frame = (commands[name][0] for name in ("channelCfg", "adcCfg", "frameCfg"))
    chirps: dict[int, list[float]] = {}
    for chirp in commands["chirpCfg"]:
        chirps |= dict.fromkeys(range(int(chirp[0]), int(chirp[1]) + 1), chirp)
    first, last = int(frame[0]), int(frame[1])
    profile = {p[0]: p for p in commands["profileCfg"]}[chirps[first][2]]
    return CaptureConfig(
        receivers=int(channel[0]).bit_count(),
        complex_samples=adc[1] > 0,
        start_ghz=profile[1],
        idle_us=profile[2],
        adc_start_us=profile[3],
        ramp_end_us=profile[4],
        slope_mhz_us=profile[7],
        samples=int(profile[9]),
        rate_ksps=profile[10],
        transmitters=tuple(int(chirps[number][7]) for number in range(first, last + 1)),
        loops=int(frame[2]),
        frame_ms=frame[4],
        frames=int(frame[3]),
    )


def _from_json(document: Any) -> CaptureConfig:
    radio = document["mmWaveDevices"][0]["rfConfig"]
    frame = radio["rlFrameCfg_t"]
    chirps: dict[int, Any] = {}
    for entry in radio["rlChirps"]:
        chirp = entry["rlChirpCfg_t"]
        chirps |= dict.fromkeys(range(chirp["chirpStartIdx"], chirp["chirpEndIdx"] + 1), chirp)
    first, last = frame["chirpStartIdx"], frame["chirpEndIdx"]
    profiles = {entry["rlProfileCfg_t"]["profileId"]: entry["rlProfileCfg_t"] for entry in radio["rlProfiles"]}
    profile = profiles[chirps[first]["profileId"]]
    return CaptureConfig(
        receivers=_bits(radio["rlChanCfg_t"]["rxChannelEn"]).bit_count(),
        complex_samples=radio["rlAdcOutCfg_t"]["fmt"]["b2AdcOutFmt"] > 0,
        start_ghz=float(profile["startFreqConst_GHz"]),
        idle_us=float(profile["idleTimeConst_usec"]),
        adc_start_us=float(profile["adcStartTimeConst_usec"]),
        ramp_end_us=float(profile["rampEndTime_usec"]),
        slope_mhz_us=float(profile["freqSlopeConst_MHz_usec"]),
        samples=int(profile["numAdcSamples"]),
        rate_ksps=float(profile["digOutSampleRate"]),
        transmitters=tuple(_bits(chirps[number]["txEnable"]) for number in range(first, last + 1)),
        loops=int(frame["numLoops"]),
        frame_ms=float(frame["framePeriodicity_msec"]),
        frames=int(frame.get("numFrames", 0)),
    )


def _bits(mask: Any) -> int:
    return int(mask, 0) if isinstance(mask, str) else int(mask)


def config_text(array: MimoArray, chirp: Chirp, frame_rate_hz: float, frames: int, per_count: float) -> str:
    """Return the configuration of a simulated module, with sqrt(W) of one count as a remark."""
    period_us = 1e6 * array.period_s
    start_ghz = 1e-9 * (chirp.carrier_hz - chirp.slope_hz_s * chirp.duration_s / 2)
    masks: Float[np.ndarray, "code tx"] = np.abs(array.code) > 0
    lines = [
        f"% sionna-radar; one count is {per_count:.6e} of the square root of a watt",
        f"channelCfg {(1 << len(array.receiver_m)) - 1} {(1 << len(array.transmitter_m)) - 1} 0",
        f"adcCfg 2 {int(chirp.sampling == 'iq')}",
        f"profileCfg 0 {start_ghz:.9f} 0 0 {period_us:.6f} 0 0 {1e-12 * chirp.slope_hz_s:.9f} 1 {chirp.samples} "
        f"{1e-3 * chirp.sampling_rate_hz:.6f} 0 0 30",
        *(f"chirpCfg {n} {n} 0 0 0 0 0 {sum(1 << i for i in np.flatnonzero(mask))}" for n, mask in enumerate(masks)),
        f"frameCfg 0 {len(array.code) - 1} {array.blocks} {frames} {1e3 / frame_rate_hz:.6f} 1 0",
        "sensorStart",
    ]
    return "\n".join(lines) + "\n"
