"""Frames: what a sensor heard between two steps, or what a recording holds of as long a time."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Inexact

from sionna_radar.detection.detector import Spectra
from sionna_radar.detection.echoes import Echoes, Profiles
from sionna_radar.detection.ranging.estimators import RangeLoop
from sionna_radar.flight.pulses import Pulses
from sionna_radar.mapping.points import Points, locate
from sionna_radar.survey.sensors.sensor import Observation, Sensor, SensorWithSweeps, corrected
from sionna_radar.tracing.paths import Paths


@dataclass(frozen=True, kw_only=True)
class Frame:
    """What a radar heard between two steps; all columns are NumPy arrays, one row a pulse, an echo or a point.

    time_s: of the step.
    pulses: the pulses that were transmitted, with their times, true and measured poses.
    echoes: their echoes, ranges corrected for Doppler by the measured velocity.
    points: the same echoes in the world frame, placed by the measured poses, in the order of the echoes.
    profiles: range profiles around the echoes, where the DEM method uses them; None elsewhere.
    observation: of the sensor as it is: paths, which are the truth, beat signals, and samples that were clipped.
    waiting: pulses that were transmitted and wait for the end of their scan line, as behind rain.
    notice: why there are fewer pulses or echoes than expected; empty otherwise.
    sensor: what heard it.
    """

    time_s: float
    pulses: Pulses
    echoes: Echoes
    points: Points
    profiles: Profiles | None
    observation: Observation | None
    waiting: int = 0
    notice: str = ""
    sensor: Sensor = field(repr=False)

    def __len__(self) -> int:
        return len(self.pulses)

    def __repr__(self) -> str:
        notice = f"\n  {self.notice}" if self.notice else ""
        return f"Frame at {self.time_s:.6g} s: {len(self.pulses):,} pulses, {len(self.echoes):,} echoes{notice}"

    @property
    def readings_m(self) -> Float[np.ndarray, " pulse"]:
        """Range of the strongest echo of each pulse; NaN for a pulse without an echo."""
        reading_m = np.full(len(self.pulses), np.nan)
        weakest_first = np.argsort(self.echoes.power, kind="stable")
        reading_m[self.pulses.row_of(self.echoes.pulse[weakest_first])] = self.echoes.range_m[weakest_first]
        return reading_m

    @property
    def beats(self) -> tuple[Inexact[np.ndarray, "chirp sample"], ...]:
        """Beat signals of each sweep of a pulse, V at 1 ohm, chirp by chirp; empty for a sensor without."""
        beats = None if self.observation is None else self.observation.beats
        return () if beats is None else tuple(beats)

    @cached_property
    def spectra(self) -> Spectra | None:
        """Range spectra of the first sweep of each pulse: power, W, and CFAR threshold in each cell.

        None for a sensor without sweeps, or a frame without pulses. Their ranges are `range_m`.
        """
        if not isinstance(self.sensor, SensorWithSweeps) or not self.beats:
            return None
        sweeps = self.sensor.sweeps
        return sweeps.detector.spectra(sweeps.cleaned(self.beats, self.pulses)[0])

    @property
    def range_m(self) -> Float[np.ndarray, " cell"]:
        """Range axis of the spectra, not corrected for Doppler; empty for a sensor without sweeps."""
        if not isinstance(self.sensor, SensorWithSweeps):
            return np.zeros(0)
        return self.sensor.sweeps.detector.analyser.range_m


def listen(
    sensor: Sensor,
    time_s: float,
    blocks: Sequence[Pulses],
    none: Pulses,
    *,
    loop: RangeLoop | None,
    keep_profiles: bool,
    waiting: int = 0,
) -> Frame:
    """Observe pulses block by block, and place their echoes by the measured poses.

    none: an empty block, for a frame without pulses. loop: over the ranges, see `corrected`.
    """
    seen = [sensor.observe(pulses) for pulses in blocks]
    echoes = [corrected(sensor, each.echoes, pulses, loop) for pulses, each in zip(blocks, seen, strict=True)] or [
        no_echoes()
    ]
    blocks = blocks or [none]
    points = [locate(each, pulses.index, pulses.measured) for pulses, each in zip(blocks, echoes, strict=True)]
    profiles = [each.profiles for each in seen if each.profiles is not None and keep_profiles]
    return Frame(
        time_s=time_s,
        pulses=Pulses.concatenate(blocks),
        echoes=Echoes.concatenate(echoes),
        points=Points.concatenate(points),
        profiles=Profiles.concatenate(profiles) if profiles else None,
        observation=_joined(seen),
        waiting=waiting,
        sensor=sensor,
    )


def no_echoes() -> Echoes:
    """Return a table without echoes."""
    number, value = np.zeros(0, dtype=np.int64), np.zeros(0)
    return Echoes(pulse=number, number=number, range_m=value, range_sigma_m=value, power=value, echo_snr_db=value)


def _joined(seen: list[Observation]) -> Observation | None:
    if len(seen) < 2:
        return seen[0] if seen else None

    def together(name: str) -> Any:
        columns = [getattr(each, name) for each in seen]
        if any(column is None for column in columns):
            return None
        return np.concatenate(columns) if isinstance(columns[0], np.ndarray) else columns

    beats, profiles = together("beats"), together("profiles")
    return Observation(
        paths=Paths.concatenate([each.paths for each in seen]),
        echoes=Echoes.concatenate([each.echoes for each in seen]),
        profiles=None if profiles is None else Profiles.concatenate(profiles),
        through_volume=seen[0].through_volume,
        beats=None if beats is None else tuple(np.concatenate(sweep) for sweep in zip(*beats, strict=True)),
        frames=together("frames"),
        saturated=together("saturated"),
    )
