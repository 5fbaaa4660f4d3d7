"""Recordings that are described by a file beside them: signals in memory, or ranges that were read before."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Complex, Float, Inexact, Int, Num
from scipy.constants import speed_of_light
from scipy.signal import hilbert

from sionna_radar.detection.echoes import Echoes
from sionna_radar.flight.pulses import Pose, Pulses
from sionna_radar.foundation.input_file import parse_toml
from sionna_radar.foundation.raster import Georeference
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scenario.recorded import RecordedRadar
from sionna_radar.survey.recordings.signal_file import RecordedPulses, sweeps_of

# Samples of the nominal sweep of readings; its range cells alone count.
CELLS_OF_READINGS = 4096
# What alone returns the powers of profiles as they are: the analysis without a window and zero-padding.
WHOLE_CELLS: dict[str, Any] = {"processing.window": "boxcar", "processing.zero_padding": 1}
PoseAt = Callable[[Float[np.ndarray, " n"]], Pose]


@dataclass(frozen=True, kw_only=True, eq=False)
class Described:
    """A recording that a TOML file describes.

    time_s: of each pulse, from the first position of the log, or else from the first pulse.
    pose_at: returns the poses at some times; None if they are not known.
    settings: values of `processing`, `dem` and `radar` in the description, by dotted keys. files: that it names.
    warnings: what its user should know of it.
    """

    time_s: Float[np.ndarray, " pulse"]
    pose_at: PoseAt | None
    georeference: Georeference | None
    settings: Mapping[str, Any]
    files: tuple[Path, ...]
    warnings: tuple[str, ...] = ()
    scenario: None = None
    flight: None = None
    truth: None = None

    @property
    def replaced(self) -> dict[str, str]:
        """No parts: nothing was simulated."""
        return {}

    @cached_property
    def pulses(self) -> RecordedPulses:
        """The pulses."""
        time_s, pose_at = self.time_s, self.pose_at
        poses = None if pose_at is None else lambda index: pose_at(time_s[index])
        return RecordedPulses(poses=poses, time_s=time_s, scan_rad=np.zeros(len(time_s)), scan_number=None, beam=None)

    def pose(self, index: Int[np.ndarray, " pulse"]) -> Pose:
        """Return the poses of pulses."""
        assert self.pose_at is not None
        return self.pose_at(self.time_s[index])


@dataclass(frozen=True, kw_only=True, eq=False)
class DescribedSignals(Described):
    """Beat signals of one receiver, or of an array's frames, in memory, with the interface of `SignalFile`.

    samples: complex for I/Q.
    background: subtracted from each sweep. response: of channels, divided out. range_zero_m: range read at zero.
    powers: whether only the powers of the spectra are known, cell by cell.
    """

    samples: Num[np.ndarray, "pulse *channel sample"]
    radar: RecordedRadar
    background: Inexact[np.ndarray, "*channel sample"] | None
    response: Complex[np.ndarray, "chirp rx 1"] | None
    range_zero_m: float
    powers: bool

    @property
    def channels(self) -> tuple[int, ...]:
        """Chirps of a frame and receivers of an array; none for a single one."""
        return self.samples.shape[1:-1]

    @cached_property
    def sweeps(self) -> tuple[Chirp, ...]:
        """The sweep of a pulse."""
        return sweeps_of(self.radar, self.samples.shape[-1], np.iscomplexobj(self.samples))

    def beats(self, pulses: Pulses) -> list[Inexact[np.ndarray, "pulse *channel sample"]]:
        """Return the beat signals of pulses, with ranges that count from the radar's zero."""
        beat = self.samples[pulses.index]
        beat = beat.astype(np.complex128 if np.iscomplexobj(beat) else np.float64)
        if self.background is not None:
            beat = beat - self.background
        if self.response is not None:
            beat = beat / self.response if np.iscomplexobj(beat) else np.real(hilbert(beat) / self.response)
        if self.range_zero_m:
            (chirp,) = self.sweeps
            slope = chirp.bandwidth_hz * self.radar.sampling_rate_hz / chirp.samples
            shift_hz = 2 * slope * self.range_zero_m / self.radar.propagation_mps
            turned = np.exp(-2j * np.pi * shift_hz * np.arange(chirp.samples) / self.radar.sampling_rate_hz)
            beat = beat * turned if np.iscomplexobj(beat) else np.real(hilbert(beat) * turned)
        return [beat]


@dataclass(frozen=True, kw_only=True, eq=False)
class DescribedRanges(Described):
    """Ranges that a radar or laser read by itself, as an altimeter does.

    range_m, sigma_m: of each pulse, NaN without a reading; sigma is 0 where it is not known.
    cell_m: length of a range cell of the radar that read them.
    """

    range_m: Float[np.ndarray, " pulse"]
    sigma_m: Float[np.ndarray, " pulse"]
    cell_m: float

    @property
    def sweeps(self) -> tuple[Chirp, ...]:
        """A sweep with the range cells of the readings, of which no samples are known."""
        bandwidth_hz = speed_of_light / (2 * self.cell_m)
        radar = RecordedRadar(carrier_hz=max(bandwidth_hz, 1e9), bandwidth_hz=bandwidth_hz, sampling_rate_hz=1e6)
        return sweeps_of(radar, CELLS_OF_READINGS, iq=False)

    def echoes(self, pulses: Pulses) -> Echoes:
        """Return the readings of some pulses; power and signal-to-noise ratio are not known."""
        range_m = self.range_m[pulses.index]
        known = np.isfinite(range_m)
        count = int(np.count_nonzero(known))
        return Echoes(
            pulse=pulses.index[known],
            number=np.zeros(count, dtype=np.int64),
            range_m=range_m[known],
            range_sigma_m=self.sigma_m[pulses.index][known],
            power=np.ones(count),
            echo_snr_db=np.full(count, np.nan),
        )


def is_recording(path: Path) -> bool:
    """Return True for a file of recorded signals, and for a TOML file that describes a recording."""
    if path.suffix.lower() != ".toml":
        return path.suffix.lower() in (".nc", ".bin")
    try:
        return not {"recording", "readings"}.isdisjoint(parse_toml(path.read_text(encoding="utf-8")))
    except (OSError, ValueError):
        return False
