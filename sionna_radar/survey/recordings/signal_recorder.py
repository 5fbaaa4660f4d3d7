"""Recorder of the beat signals of a survey, and of the truth that they are compared with.

The layout is that of recordings of real radars, too: see `SignalFile`.
"""

import math
from pathlib import Path

import numpy as np
from jaxtyping import Bool

from sionna_radar.accuracy.truth import Comparison
from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.errors import PluginError, ScenarioError
from sionna_radar.foundation.raster import Raster
from sionna_radar.radar.mimo_array import MimoArray
from sionna_radar.scenario.readers import CAPTURE_WRITER
from sionna_radar.survey.observation import SampleType
from sionna_radar.survey.preparation import Prepared
from sionna_radar.survey.recordings.netcdf import check_room
from sionna_radar.survey.recordings.recording_head import new_recording, write_pulses
from sionna_radar.survey.recordings.signal_file import is_capture
from sionna_radar.survey.sensors.sensor import Observation

FULL_SCALE = 2**15 - 1
PACKED_AT_ONCE = 4_000_000


class SignalRecorder:
    """Writes the beat signals of each block, of an array those of all chirps and receivers, and the true heights.

    Samples of 64 bits give the same ranges, points and DEM again, bit for bit. Those of 16 bits are packed after the
    flight, when the greatest is known: until then they lie beside the recording in 32 bits. Those of a raw capture go
    into that, and all else into a netCDF file beside it.
    """

    def __init__(self, path: Path, prepared: Prepared, sample_type: SampleType = "float64") -> None:
        array = prepared.instrument.module
        chirp, self._sweeps = prepared.receiver.chirp, len(prepared.receiver.sweeps)
        self._parts = ("beat_i", "beat_q") if chirp.sampling == "iq" else ("beat_i",)
        self._capture = None
        if array is not None and is_capture(path):
            noise_w, rate_hz = prepared.receiver.noise_power_w / len(self._parts), prepared.instrument.pulse_rate_hz
            self._capture = CAPTURE_WRITER(path, noise_w, array, chirp, rate_hz, len(prepared))
            path = path.with_suffix(".nc")
        kind = "cube" if prepared.scenario.sensor == "mimo" else "signals"
        self._file = new_recording(path, prepared, kind, "beat signals of a simulated FMCW radar")
        self._prepared = prepared
        packed = sample_type == "int16" and self._capture is None
        self._loose = {name: path.with_suffix(f".{name}") for name in self._parts} if packed else {}
        self._greatest = 0.0
        self._axes = {"sweep": self._sweeps} if self._sweeps > 1 else {}
        if array is not None:
            self._axes = {"chirp": array.chirps, "receiver": len(array.receiver_m)}
        self._axes |= {"sample": chirp.samples}
        samples = len(prepared) * math.prod(self._axes.values()) * len(self._parts)
        check_room(path.parent, samples * (4 + 2 if self._loose else np.dtype(sample_type).itemsize))
        for name, size in self._axes.items():
            self._file.dimension(name, size)
        self._add_radar()
        if array is not None:
            self._add_array(array)
        if self._capture is None and not self._loose:
            self._add_samples(np.dtype(sample_type))

    def write(self, pulses: Pulses, seen: Observation) -> None:
        """Write a block of pulses and their beat signals."""
        write_pulses(self._file, pulses)
        samples = self._samples(pulses, seen)
        if self._capture is not None:
            self._capture.write(pulses.index, samples)
            return
        for name, values in zip(self._parts, (samples.real, samples.imag), strict=False):
            if self._loose:
                self._greatest = max(self._greatest, float(np.abs(values).max(initial=0.0)))
                with self._loose[name].open("ab") as loose:
                    loose.write(np.ascontiguousarray(values, dtype="<f4").tobytes())
            else:
                self._file.write(name, int(pulses.index[0]), values)

    def finish(self, comparison: Comparison) -> None:
        """Add the truth on the DEM's grid, pack the samples if they are to be, and close the file."""
        self._add_truth(comparison.truth)
        self._add_mask("lit", comparison.lit, "whether the main beam reached the cell", "unlit lit")
        if comparison.beside_wall is not None:
            meaning = "whether a wall lies within half a footprint of the cell"
            self._add_mask("beside_wall", comparison.beside_wall, meaning, "away_from_walls beside_wall")
        if self._loose:
            self._pack()
        self.close()

    def _add_mask(self, name: str, cells: Bool[np.ndarray, "row column"], meaning: str, flags: str) -> None:
        self._file.variable(
            name,
            ("y", "x"),
            cells.astype(np.int8),
            long_name=meaning,
            flag_values=np.array([0, 1], dtype=np.int8),
            flag_meanings=flags,
        )

    def _add_truth(self, truth: Raster) -> None:
        """Add the true heights over the origin; on the map their cells have its coordinates, otherwise local ones.

        Attributes keep the local grid exactly.
        """
        place, grid = self._prepared.world.scene.georeference, truth.grid
        east_m, north_m, _ = place.origin_m if place else (0.0, 0.0, 0.0)
        for name, values, way in (("x", grid.x_m + east_m, "east"), ("y", grid.y_m + north_m, "north")):
            self._file.dimension(name, len(values))
            self._file.variable(
                name,
                (name,),
                values,
                long_name=f"centre of a cell: {way}ing" if place else f"centre of a cell, {way} of the origin",
                standard_name=f"projection_{name}_coordinate" if place else None,
                units="m",
            )
        self._file.variable(
            "true_height",
            ("y", "x"),
            truth.height_m,
            long_name="true height over the height of the local origin",
            units="m",
            grid_mapping="crs" if place else None,
            local_west_m=grid.west_m,
            local_south_m=grid.south_m,
            spacing_m=grid.spacing_m,
        )

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        if self._capture is not None:
            self._capture.close()

    def _samples(self, pulses: Pulses, seen: Observation) -> np.ndarray:
        """Return the samples of a block as the file has them."""
        if seen.frames is not None:
            return seen.frames
        if seen.beats is None:
            message = f"{self._prepared.scenario.sensor!r} makes no beat signals to record; record 'paths' instead"
            raise ScenarioError.of("sensor", message)
        wanted = (len(pulses), self._prepared.receiver.chirp.samples)
        if len(seen.beats) != self._sweeps or any(np.shape(beat) != wanted for beat in seen.beats):
            raise PluginError(f"sensor: beats are to be {self._sweeps} arrays of {wanted}, one for each sweep")
        return seen.beats[0] if self._sweeps == 1 else np.stack(list(seen.beats), axis=1)

    def _add_array(self, array: MimoArray) -> None:
        for name in ("transmitter", "receiver"):
            places, text = getattr(array, f"{name}_m"), f"places of the {name}s along boresight, left and up"
            if name not in self._axes:
                self._file.dimension(name, len(places))
            self._file.variable(f"{name}_place", (name, "axis"), places, long_name=text, units="m")
        self._file.dimension("code", len(array.code))
        for part, factor in (("real", array.code.real), ("imaginary", array.code.imag)):
            text = f"{part} part of each transmitter's factor in the chirps of a block"
            self._file.variable(f"code_{part}", ("code", "transmitter"), factor.copy(), long_name=text, units="1")

    def _add_radar(self) -> None:
        prepared, file = self._prepared, self._file
        receiver, chirp = prepared.receiver, prepared.receiver.chirp
        file.variable(
            "sample_time",
            ("sample",),
            chirp.sample_time_s,
            long_name="time of the sample from the middle of its sweep",
            units="s",
        )
        flight, radar = prepared.plan.flown, prepared.local.radar
        rate_hz = prepared.instrument.mean_rate_hz
        capture, array = self._capture, prepared.instrument.module
        file.variable(
            "radar",
            (),
            np.int32(0),
            long_name="the radar, by its attributes",
            carrier_hz=chirp.carrier_hz,
            bandwidth_hz=chirp.bandwidth_hz,
            sampling_rate_hz=chirp.sampling_rate_hz,
            sweep=radar.sweep,
            gate_delay_us=radar.gate_delay_us or None,
            propagation_mps=chirp.propagation_mps,
            transmit_power_w=receiver.transmit_power_w,
            noise_power_w=receiver.noise_power_w,
            chirp_period_s=array.period_s if array else None,
            capture=capture.name if capture else None,
            count=capture.per_count if capture else None,
        )
        file.variable(
            "survey",
            (),
            np.int32(0),
            long_name="what maps need of the flight, by attributes: the ground that is mapped (west, south, east, "
            "north), the height over it, and the widest spacing of neighbouring beams on level ground",
            ground_extent_m=np.array(prepared.plan.ground_extent_m),
            altitude_m=flight.altitude_m,
            beam_spacing_m=prepared.flight.scan.spacing_m(flight.altitude_m, flight.speed_mps, rate_hz),
        )

    def _add_samples(self, kind: np.dtype, **attributes: float) -> None:
        dimensions = ("pulse", *self._axes)
        relative = self._prepared.local.radar.snr_db is not None
        power = "the mean of I² + Q²" if len(self._parts) > 1 else "its mean square"
        for name, part in zip(self._parts, ("in-phase", "quadrature"), strict=False):
            self._file.variable(
                name,
                dimensions,
                dtype=kind,
                long_name=f"beat signal, {part} part" if len(self._parts) > 1 else "beat signal",
                units="1" if relative else "V",
                comment=f"{power} is the received power"
                + (", relative to the transmitted one" if relative else " in W, as across 1 ohm"),
                coordinates="time sample_time",
                **attributes,
            )

    def _pack(self) -> None:
        """Write the loose samples as whole numbers of 16 bits, the greatest at full scale."""
        scale = (self._greatest or 1.0) / FULL_SCALE
        self._add_samples(np.dtype(np.int16), scale_factor=scale, add_offset=0.0)
        shape = tuple(self._axes.values())
        step = max(1, PACKED_AT_ONCE // math.prod(shape))
        for name, loose in self._loose.items():
            kept = np.memmap(loose, dtype="<f4", mode="r").reshape(-1, *shape)
            for start in range(0, len(kept), step):
                self._file.write(name, start, np.rint(kept[start : start + step] / scale).astype(np.int16))
            del kept
            loose.unlink()
