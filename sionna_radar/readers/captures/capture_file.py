"""The raw layout of Texas Instruments' capture card (DCA1000), with its chirp configuration.

The card writes 16-bit numbers, little-endian, chirp by chirp; in a chirp receiver by receiver, complex samples in pairs
as I, I, Q, Q (two lanes: xWR16xx, xWR18xx, xWR68xx); on four lanes (xWR12xx, xWR14xx) sample by sample, the I of all
receivers and then their Q (TI application report SWRA581B, "Mmwave Radar Device ADC Raw Data Capture"). Frames of an
array are written for two lanes. The configuration (.cfg) is that of the mmWave SDK; it holds one `chirpCfg` for each
chirp of a block. Real samples are written as they come.
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Inexact, Int, Num

from sionna_radar.foundation.errors import InputFileError, OutputError
from sionna_radar.foundation.input_file import read_text, shown
from sionna_radar.foundation.sequences import spread_indices
from sionna_radar.radar.chirp import Chirp
from sionna_radar.radar.mimo_array import MimoArray

# Noise of a sample, in counts of the converter: that of a module's frames indoors (docs/checks/module.md).
NOISE_COUNTS = 7.0
LARGEST_COUNT = 32767
# Coherence of cells with those of the negative frequencies from which samples are in the wrong order: of noise it is
# 0.9 over the root of the chirps. Chirps for it, at least and at most; cells at either end that hold leakage.
MIN_MIRRORED = 0.1
MIN_CHIRPS, MAX_CHIRPS, NEAR_CELLS = 128, 512, 4
# Chirps that a configuration may define (mmWave SDK: numbers 0 to 511), and generous bounds of its other values: a mask
# of a device has four receivers and three transmitters, a cascade of four devices 16 and 12.
CHIRP_NUMBERS = 512
MAX_RECEIVERS, MAX_TRANSMITTERS, MAX_SAMPLES, MAX_LOOPS, MAX_FRAMES = 16, 16, 2**18, 2**16, 2**32
# GHz, and of times, rates and slopes in the units of the files. Rounding of the frame period, as a share.
MIN_GHZ, MAX_GHZ, MIN_POSITIVE, MAX_VALUE, ROUNDED = 1.0, 1000.0, 1e-6, 1e9, 1e-3


class CaptureWriter:
    """A raw capture of an array's frames that grows, with its configuration beside it.

    noise_power_w: of each part of a sample. frame_rate_hz, frames: of the whole capture.
    per_count: sqrt(W) of one count.
    """

    def __init__(
        self, path: Path, noise_power_w: float, array: MimoArray, chirp: Chirp, frame_rate_hz: float, frames: int
    ) -> None:
        self.name, self.per_count = path.name, float(np.sqrt(noise_power_w)) / NOISE_COUNTS
        config = config_text(array, chirp, frame_rate_hz, frames, self.per_count)
        path.with_suffix(".cfg").write_text(config, encoding="ascii")
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
    """Return the counts of a frame as a capture has them: two in-phase parts, then two quadrature parts."""
    if not np.iscomplexobj(frame):
        return np.rint(frame).astype(np.int64).ravel()
    pairs = frame.reshape(*frame.shape[:2], -1, 1, 2)
    return np.rint(np.concatenate([pairs.real, pairs.imag], axis=3)).astype(np.int64).ravel()


@dataclass(frozen=True, kw_only=True)
class CapturedFrames:
    """Frames of a raw capture whose configuration lies beside it.

    raw: numbers in the order of the file. leftover_bytes: behind the last whole frame.
    """

    raw: Int[np.ndarray, "frame chirp value"]
    config: "CaptureConfig"
    leftover_bytes: int

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Frames, chirps, receivers and samples."""
        return len(self.raw), self.raw.shape[1], self.config.receivers, self.config.samples

    def samples(self, index: Int[np.ndarray, " frame"]) -> Num[np.ndarray, "frame chirp rx sample"]:
        """Return frames in counts."""
        return receiver_samples(self.raw[index], self.config)


def open_capture(path: Path) -> CapturedFrames:
    """Return the frames of a capture, by the configuration (.cfg) beside it; InputFileError if that is unreadable."""
    config = capture_config(path.with_suffix(".cfg"))
    return CapturedFrames(
        raw=capture_frames(path, config), config=config, leftover_bytes=bytes_after_frames(path, config)
    )


CONFIG_REMEDY = "name the chirp configuration of the capture, a .cfg or .mmwave.json file"


@dataclass(frozen=True, kw_only=True)
class ChirpConfig:
    """A chirp, by its profile and its own variations: GHz, MHz/us, us and ksps."""

    start_ghz: float
    slope_mhz_us: float
    idle_us: float
    adc_start_us: float
    ramp_end_us: float
    samples: int
    rate_ksps: float


@dataclass(frozen=True, kw_only=True)
class CaptureConfig(ChirpConfig):
    """The configuration of a capture, whose chirps differ in their transmitters alone; frame_ms: frame period, ms.

    frames: stated number; 0 for any.
    """

    receivers: int
    complex_samples: bool
    transmitters: tuple[int, ...]
    loops: int
    frame_ms: float
    frames: int

    @property
    def chirps_per_frame(self) -> int:
        """Chirps of a frame, of all transmitters."""
        return len(self.transmitters) * self.loops

    @property
    def chirp_us(self) -> float:
        """Time from chirp to chirp."""
        return self.idle_us + self.ramp_end_us


def frame_bytes(config: CaptureConfig) -> int:
    """Return the size of a frame in a capture."""
    return 2 * config.receivers * config.samples * (2 if config.complex_samples else 1) * config.chirps_per_frame


def capture_frames(path: Path, config: CaptureConfig) -> Int[np.ndarray, "frame chirp value"]:
    """Return the raw values of all chirps of the whole frames, mapped into memory; InputFileError without one.

    A capture that is stopped by hand ends within a frame: `bytes_after_frames` says how much of it is left out.
    """
    size, one = path.stat().st_size, frame_bytes(config)
    if size < one:
        reason = f"holds {size:,} bytes, less than the {one:,} of one frame of its configuration"
        raise InputFileError(f"{shown(path)}: {reason}; get the whole file, or name its own configuration")
    chirps = config.chirps_per_frame
    return np.memmap(path, dtype="<i2", mode="r", shape=(size // one, chirps, one // (2 * chirps)))


def bytes_after_frames(path: Path, config: CaptureConfig) -> int:
    """Return the bytes of a capture that follow its last whole frame."""
    return path.stat().st_size % frame_bytes(config)


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


def inferred_lanes(raw: Int[np.ndarray, "frame chirp value"], config: CaptureConfig, lanes: int) -> int:
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
        """Return the coherence of ranges with their mirror images if the lanes had an order, 0 to 1."""
        samples = receiver_samples(chosen, config, order, 0).astype(np.complex128)
        cells = np.fft.fft((samples - samples.mean(axis=0)) * np.hanning(config.samples))[
            :, NEAR_CELLS : 1 - NEAR_CELLS
        ]
        power = np.sum(np.abs(cells) ** 2, axis=0)
        total = np.maximum(power, power[::-1]).sum()
        return float(np.abs(np.sum(cells * cells[:, ::-1], axis=0)).sum() / total) if total > 0 else 0.0

    return 6 - lanes if mirrored(lanes) > MIN_MIRRORED >= mirrored(6 - lanes) else lanes


def capture_config(path: Path) -> CaptureConfig:
    """Return the configuration of a capture; InputFileError for one that lacks a value or contradicts itself."""
    text = read_text(path, "recording.config =", CONFIG_REMEDY)
    try:
        config = _from_json(json.loads(text)) if text.lstrip().startswith("{") else _from_lines(text)
    except KeyError as error:
        raise InputFileError(f"{shown(path)}: has no {error.args[0]}; {CONFIG_REMEDY}") from None
    except RecursionError:
        raise InputFileError(f"{shown(path)}: is nested too deeply for a chirp configuration") from None
    except (ValueError, TypeError, IndexError, OverflowError) as error:
        raise InputFileError(f"{shown(path)}: cannot be read as a chirp configuration ({error})") from None
    for problem in _problems(config):
        raise InputFileError(f"{shown(path)}: {problem}; correct it, or name the configuration of this capture")
    return config


def _problems(config: CaptureConfig) -> Iterator[str]:
    """Yield values that no capture can have been recorded with."""
    bounds = {
        "receivers": (config.receivers, 1, MAX_RECEIVERS),
        "samples of a chirp": (config.samples, 1, MAX_SAMPLES),
        "loops of a frame": (config.loops, 1, MAX_LOOPS),
        "frames": (config.frames, 0, MAX_FRAMES),
        "start frequency (GHz)": (config.start_ghz, MIN_GHZ, MAX_GHZ),
        "size of the slope (MHz/us)": (abs(config.slope_mhz_us), MIN_POSITIVE, MAX_VALUE),
        "sampling rate (ksps)": (config.rate_ksps, MIN_POSITIVE, MAX_VALUE),
        "idle time (us)": (config.idle_us, 0, MAX_VALUE),
        "start of sampling (us)": (config.adc_start_us, 0, MAX_VALUE),
        "end of the ramp (us)": (config.ramp_end_us, MIN_POSITIVE, MAX_VALUE),
        "frame period (ms)": (config.frame_ms, MIN_POSITIVE, MAX_VALUE),
    }
    for name, (value, least, most) in bounds.items():
        if not least <= value <= most:  # also of nan
            yield f"{name}: {shown(value)} is not within {least:g} to {most:g}"
    if not all(0 < mask < 1 << MAX_TRANSMITTERS for mask in config.transmitters):
        yield f"transmitters of the chirps: {shown(list(config.transmitters))} are not masks of transmitters"
    if config.complex_samples and config.samples % 2:
        yield f"samples of a chirp: {config.samples} is odd, and complex samples are stored in pairs"
    busy_ms = 1e-3 * config.chirp_us * config.chirps_per_frame
    if config.frame_ms < busy_ms * (1 - ROUNDED):
        yield f"frame period: {config.frame_ms:g} ms is shorter than the {busy_ms:g} ms of its chirps"


def _chirps_of_frame(spans: Sequence[tuple[int, int]], first: int, last: int) -> list[int]:
    """Return the definition of each chirp of a frame, the last of several; spans: of chirps that each is for.

    Raises ValueError for numbers that run backwards, are beyond those of the mmWave SDK, or have no definition.
    """
    definition = np.full(CHIRP_NUMBERS, -1)
    for what, (start, end) in [*(("a definition", span) for span in spans), ("the frame", (first, last))]:
        if not 0 <= start <= end < CHIRP_NUMBERS:
            numbers = f"chirps {shown(start)} to {shown(end)}"
            raise ValueError(f"{what} is of {numbers}; they ascend, and are 0 to {CHIRP_NUMBERS - 1}")
    for number, (start, end) in enumerate(spans):
        definition[start : end + 1] = number
    chosen = definition[first : last + 1]
    if (chosen < 0).any():
        raise ValueError(f"chirp {first + int(np.argmin(chosen))} of the frame is not defined")
    return [int(number) for number in chosen]


def _one_kind(chirps: Iterable[ChirpConfig]) -> dict[str, Any]:
    """Return the values that all chirps of a frame share; ValueError if they differ."""
    first, *others = map(vars, chirps)
    differ = {
        name for other in others for name in first if not np.array_equal(first[name], other[name], equal_nan=True)
    }
    if differ:
        raise ValueError(
            f"the chirps of a frame differ in {', '.join(sorted(differ))}; record frames of one kind of chirp"
        )
    return first


# Commands of a .cfg that are read, with the least number of their values.
COMMANDS = {"channelCfg": 1, "adcCfg": 2, "profileCfg": 11, "chirpCfg": 8, "frameCfg": 5}


def _from_lines(text: str) -> CaptureConfig:
    commands: dict[str, list[list[float]]] = {}
    for line in text.splitlines():
        words = line.split("%")[0].split()
        if words and words[0] in COMMANDS:
            values = [float(word) for word in words[1:]]
            if len(values) < COMMANDS[words[0]]:
                raise ValueError(f"{words[0]} has {len(values)} values, and at least {COMMANDS[words[0]]} are needed")
            commands.setdefault(words[0], []).append(values)
    channel, adc, frame = (commands[name][0] for name in ("channelCfg", "adcCfg", "frameCfg"))
    chirps = commands["chirpCfg"]
    sent = _chirps_of_frame([(int(chirp[0]), int(chirp[1])) for chirp in chirps], int(frame[0]), int(frame[1]))
    profiles = {values[0]: values for values in commands["profileCfg"]}
    return CaptureConfig(
        **_one_kind(_chirp_of_values(_profile(profiles, chirps[n][2]), chirps[n]) for n in sent),
        receivers=_count(int(channel[0])),
        complex_samples=adc[1] > 0,
        transmitters=tuple(int(chirps[number][7]) for number in sent),
        loops=int(frame[2]),
        frame_ms=frame[4],
        frames=int(frame[3]),
    )


def _from_json(document: Any) -> CaptureConfig:
    radio = document["mmWaveDevices"][0]["rfConfig"]
    frame = radio["rlFrameCfg_t"]
    chirps = [entry["rlChirpCfg_t"] for entry in radio["rlChirps"]]
    spans = [(int(chirp["chirpStartIdx"]), int(chirp["chirpEndIdx"])) for chirp in chirps]
    sent = _chirps_of_frame(spans, int(frame["chirpStartIdx"]), int(frame["chirpEndIdx"]))
    profiles = {entry["rlProfileCfg_t"]["profileId"]: entry["rlProfileCfg_t"] for entry in radio["rlProfiles"]}
    return CaptureConfig(
        **_one_kind(_chirp_of_entries(_profile(profiles, chirps[n]["profileId"]), chirps[n]) for n in sent),
        receivers=_count(_bits(radio["rlChanCfg_t"]["rxChannelEn"])),
        complex_samples=radio["rlAdcOutCfg_t"]["fmt"]["b2AdcOutFmt"] > 0,
        transmitters=tuple(_bits(chirps[number]["txEnable"]) for number in sent),
        loops=int(frame["numLoops"]),
        frame_ms=float(frame["framePeriodicity_msec"]),
        frames=int(frame.get("numFrames", 0)),
    )


def _chirp_of_values(profile: Sequence[float], chirp: Sequence[float]) -> ChirpConfig:
    """Return the chirp of the values of a `profileCfg` and a `chirpCfg`, whose variations are in Hz, kHz/us, us, us."""
    start_hz, slope_khz_us, idle_us, adc_start_us = chirp[3:7]
    return ChirpConfig(
        start_ghz=profile[1] + 1e-9 * start_hz,
        slope_mhz_us=profile[7] + 1e-3 * slope_khz_us,
        idle_us=profile[2] + idle_us,
        adc_start_us=profile[3] + adc_start_us,
        ramp_end_us=profile[4],
        samples=int(profile[9]),
        rate_ksps=profile[10],
    )


def _chirp_of_entries(profile: Mapping[str, Any], chirp: Mapping[str, Any]) -> ChirpConfig:
    """Return the chirp of a `rlProfileCfg_t` and a `rlChirpCfg_t`."""

    def sum_of(constant: str, variation: str, unit: float = 1.0) -> float:
        return float(profile[constant]) + unit * float(chirp.get(variation, 0))

    return ChirpConfig(
        start_ghz=sum_of("startFreqConst_GHz", "startFreqVar_MHz", 1e-3),
        slope_mhz_us=sum_of("freqSlopeConst_MHz_usec", "freqSlopeVar_KHz_usec", 1e-3),
        idle_us=sum_of("idleTimeConst_usec", "idleTimeVar_usec"),
        adc_start_us=sum_of("adcStartTimeConst_usec", "adcStartTimeVar_usec"),
        ramp_end_us=float(profile["rampEndTime_usec"]),
        samples=int(profile["numAdcSamples"]),
        rate_ksps=float(profile["digOutSampleRate"]),
    )


def _profile(profiles: Mapping[Any, Any], number: Any) -> Any:
    if number not in profiles:
        raise ValueError(f"a chirp has profile {number}, which is not defined")
    return profiles[number]


def _count(mask: int) -> int:
    """Return the number of receivers in a mask; 0 for a negative one, which `int.bit_count` takes for its absolute."""
    return max(mask, 0).bit_count()


def _bits(mask: Any) -> int:
    bits = int(mask, 0) if isinstance(mask, str) else int(mask)
    if not 0 <= bits < 1 << 32:
        raise ValueError("a mask of channels has more than 32 bits, or is negative")
    return bits


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
