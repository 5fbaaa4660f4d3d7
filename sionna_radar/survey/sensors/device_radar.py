"""The radar sensor on a GPU: signals stay in the ray tracer's memory, from fields to range profiles.

It is used on a GPU, for engines that trace all that the radar sees, one sweep per pulse, and receivers that only add
noise. Pulses examined before the flight and all other cases use `Radar` on the host.
"""

from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, overload

import numpy as np
from jaxtyping import Float, Inexact

from sionna_radar.detection.spectrum import HOST, ArrayLibrary, gpu_library
from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.stopwatch import timed
from sionna_radar.raytracer.backend import chosen_backend
from sionna_radar.survey.sensors.radar import Radar
from sionna_radar.survey.sensors.sensor import Observation, Sensor, SensorInputs
from sionna_radar.tracing.paths import DevicePaths, DeviceTracing, Paths


def build_radar(inputs: SensorInputs) -> Sensor:
    """Return the radar: on a GPU where that traces the rays. Without CuPy the host makes the spectra."""
    return DeviceRadar(inputs, gpu_library() or HOST) if chosen_backend() == "cuda" else Radar(inputs)


class DeviceRadar(Radar):
    """A radar whose signals stay in the memory of the ray tracer; the library computes the spectra."""

    def __init__(self, inputs: SensorInputs, library: ArrayLibrary) -> None:
        super().__init__(inputs)
        self._engine, self._library = self._engine_for(inputs), library
        self._analyser = inputs.detector.analyser
        self._looks: deque[tuple[Pulses, Future[_BlockSignals]]] = deque()

    @property
    def on_device(self) -> bool:
        """Whether signals stay on the device; if not, it behaves as `Radar`."""
        return self._engine is not None

    def expect(self, pulses: Pulses) -> None:
        """Start on a block of pulses before it is observed."""
        if self._engine is None:
            super().expect(pulses)
        else:
            self._looks.append((pulses, self._thread.submit(self._block_signals, self._engine, pulses)))

    def observe(self, pulses: Pulses) -> Observation:
        """Return the echoes of a block of pulses."""
        if self._engine is None:
            return super().observe(pulses)
        if not (self._looks and self._looks[0][0] is pulses):
            self.expect(pulses)
        with timed("trace"):
            look = self._looks.popleft()[1].result()
        with timed("detect"):
            detections = self.sweeps.detect_in(look.power, pulses)
        return Observation(
            paths=look.paths,
            echoes=detections.echoes,
            profiles=detections.profiles,
            through_volume=detections.through_volume,
            beats=look.beats,
        )

    def _engine_for(self, inputs: SensorInputs) -> DeviceTracing | None:
        """Return the engine if only noise is added between its paths and the spectra."""
        receiver, detector = inputs.receiver, inputs.detector
        if receiver.chain is not None or receiver.high_pass is not None or len(receiver.sweeps) > 1:
            return None
        if receiver.chirp.squint is not None:
            return None
        if inputs.angle is not None or inputs.bursts is not None:
            return None
        if detector.leakage != "keep" or detector.interference != "keep":
            return None
        return self.tracer.device_engine

    def _block_signals(self, engine: DeviceTracing, pulses: Pulses) -> "_BlockSignals":
        """Return paths, beat signals and spectra of a block; called in the thread that traces."""
        beats, powers, tables = [], [], []
        for paths in engine.on_device(pulses):
            beats.append(self._beat(paths))
            powers.append(self._analyser.power_on_device(beats[-1], self._library))
            tables.append(paths.paths)
        return _BlockSignals(
            paths=Paths.concatenate(tables),
            power=np.concatenate(powers),
            beats=_BeatsOnHost(tuple(beats), self._library),
        )

    def _beat(self, paths: DevicePaths) -> Any:
        """Return the beat signals of a part of a block, with noise, as an array of the library."""
        # It loads the ray tracer.
        from sionna_radar.signal.device_beats import device_beats

        receiver, library = self._receiver, self._library
        clean = library.taken(device_beats(paths, receiver.chirp))
        if receiver.chirp.sampling == "iq":
            clean = clean[..., 0] + 1j * clean[..., 1]
        return np.sqrt(receiver.transmit_power_w) * clean + library.from_host(receiver.noise(paths.pulses))


@dataclass(frozen=True, kw_only=True)
class _BlockSignals:
    """Paths, power spectra and beat signals of a block of pulses."""

    paths: Paths
    power: Float[np.ndarray, "pulse bin"]
    beats: "_BeatsOnHost"


class _BeatsOnHost(Sequence[Inexact[np.ndarray, "pulse sample"]]):
    """The beat signals of a block, copied to the host on demand."""

    def __init__(self, parts: tuple[Any, ...], library: ArrayLibrary) -> None:
        self._parts, self._library = parts, library

    def __len__(self) -> int:
        return 1

    @overload
    def __getitem__(self, sweep: int) -> Inexact[np.ndarray, "pulse sample"]: ...
    @overload
    def __getitem__(self, sweep: slice) -> Sequence[Inexact[np.ndarray, "pulse sample"]]: ...
    def __getitem__(self, sweep: int | slice) -> Any:
        """Return the samples of a sweep."""
        return [np.concatenate([self._library.fetched(part) for part in self._parts])][sweep]
