"""Frames of an array in the raw layout of Texas Instruments' capture card (DCA1000), with their chirp configuration.

The card writes 16-bit numbers, little-endian, chirp by chirp and receiver by receiver: of two-lane chips pairs of
samples, in phase and then in quadrature (TI application report SWRA581, "Mmwave radar device ADC raw data capture").
The configuration (.cfg) is that of the mmWave SDK; it holds one `chirpCfg` for each chirp of a block. Real samples are
written as they come.
"""

from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Complex, Float, Inexact, Int

from sionna_radar.accuracy.truth import Comparison
from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.errors import OutputError
from sionna_radar.survey.preparation import Prepared
from sionna_radar.survey.recordings.described import capture_config, receiver_samples
from sionna_radar.survey.sensors.sensor import Observation

SUFFIX = ".bin"
# Noise of a sample, in counts of the converter: that of a module's frames indoors (docs/checks/module.md).
NOISE_COUNTS = 7.0
LARGEST_COUNT = 32767


def is_capture(path: Path) -> bool:
    """Return whether a recording is named as a raw capture."""
    return path.suffix.lower() == SUFFIX


def config_of(path: Path) -> Path:
    """Return the place of a capture's configuration."""
    return path.with_suffix(".cfg")


class CubeRecorder:
    """Records the frames of an array as a raw capture, and its configuration beside it."""

    def __init__(self, path: Path, prepared: Prepared) -> None:
        self._per_count = np.sqrt(prepared.receiver.noise_power_w) / NOISE_COUNTS
        if prepared.receiver.chirp.sampling == "iq":
            self._per_count /= np.sqrt(2)
        config_of(path).write_text(_config_text(prepared, self._per_count), encoding="ascii")
        self._path, self._file = path, path.open("wb")

    def write(self, pulses: Pulses, seen: Observation) -> None:
        """Record a block of frames."""
        assert seen.frames is not None
        for number, frame in zip(pulses.index, seen.frames, strict=True):
            counts = raw_counts(frame / self._per_count)
            if (most := int(np.abs(counts).max(initial=0))) > LARGEST_COUNT:
                message = f"frame {number} reaches {most} counts, and 16 bits hold {LARGEST_COUNT}; record netCDF"
                raise OutputError(message)
            _write(self._file, counts)

    def finish(self, comparison: Comparison) -> None:
        """Close the file."""
        del comparison
        self.close()

    def close(self) -> None:
        """Close an unfinished file."""
        self._file.close()


def raw_counts(frame: Inexact[np.ndarray, "chirp rx sample"]) -> Int[np.ndarray, " value"]:
    """Return the numbers of a frame in the order of a capture, in counts.

    Two lanes: in each receiver's chirp in-phase parts of two samples, then their quadrature parts.
    """
    if not np.iscomplexobj(frame):
        return np.rint(frame).astype(np.int64).ravel()
    pairs = frame.reshape(*frame.shape[:2], -1, 1, 2)
    return np.rint(np.concatenate([pairs.real, pairs.imag], axis=3)).astype(np.int64).ravel()


def read_frames(samples: Path, config: Path) -> Complex[np.ndarray, "frame chirp rx sample"]:
    """Return the frames of a raw capture of two lanes, of all transmitters and receivers, in counts.

    Raises InputFileError for a configuration that cannot be read.
    """
    known = capture_config(config)
    chirps = len(known.transmitters) * known.loops
    raw = np.fromfile(samples, dtype="<i2")
    values = known.receivers * known.samples * (2 if known.complex_samples else 1)
    each = raw[: len(raw) // (values * chirps) * values * chirps].reshape(-1, values)
    own = np.stack([receiver_samples(each, known, 2, receiver) for receiver in range(known.receivers)], axis=1)
    return own.reshape(-1, chirps, known.receivers, known.samples).astype(np.complex128)


def _write(file: BinaryIO, counts: Int[np.ndarray, " value"]) -> None:
    file.write(counts.astype("<i2").tobytes())


def _config_text(prepared: Prepared, per_count: float) -> str:
    array, chirp, table = prepared.module, prepared.receiver.chirp, prepared.local.radar.array
    assert array is not None
    assert table is not None
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
        f"frameCfg 0 {len(array.code) - 1} {array.blocks} {len(prepared)} {1e3 / table.frame_rate_hz:.6f} 1 0",
        "sensorStart",
    ]
    return "\n".join(lines) + "\n"
