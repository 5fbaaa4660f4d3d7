"""Recording the traced paths of a survey."""

from pathlib import Path
from typing import Any

import numpy as np

from sionna_radar.accuracy.truth import Comparison
from sionna_radar.flight.pulses import Pulses
from sionna_radar.survey.preparation import Prepared
from sionna_radar.survey.recordings.pulse_columns import new_recording, write_pulses
from sionna_radar.survey.sensors.sensor import Observation
from sionna_radar.tracing.paths import BOUNCED, TARGET, VOLUME


class PathRecorder:
    """Writes the paths of each block: delay, complex gain, range rate, incidence, hit point and surface.

    An indexed ragged array of CF: `path_pulse` is the pulse of each path.
    """

    def __init__(self, path: Path, prepared: Prepared) -> None:
        self._file = file = new_recording(path, prepared, "paths", "paths of a simulated FMCW radar")
        file.dimension("path")
        names = [f"{number} {surface.name}" for number, surface in enumerate(prepared.scene.scene.surfaces)]

        def column(name: str, kind: type, long_name: str, units: str, **attributes: Any) -> None:
            file.variable(name, ("path",), dtype=np.dtype(kind), long_name=long_name, units=units, **attributes)

        column("path_pulse", np.int64, "pulse of the path", "1", instance_dimension="pulse")
        column("delay", np.float64, "two-way delay at the middle of the chirp", "s")
        column("gain_i", np.float32, "received over transmitted wave, real part; the phase excludes the delay", "1")
        column("gain_q", np.float32, "received over transmitted wave, imaginary part", "1")
        column("range_rate", np.float32, "range rate, positive when receding", "m s-1")
        column("incidence", np.float32, "angle between ray and surface normal; NaN for targets and volumes", "rad")
        column(
            "surface", np.int32, f"surface hit; {TARGET} point target, {VOLUME} volume cell, {BOUNCED} two", "1",
            comment="; ".join(names),
        )  # fmt: skip
        file.variable(
            "hit", ("path", "axis"), dtype=np.dtype(np.float64), units="m",
            long_name="where the surface is hit: east, north, up of the local origin",
        )  # fmt: skip

    def write(self, pulses: Pulses, seen: Observation) -> None:
        """Write a block of pulses and its paths."""
        write_pulses(self._file, pulses)
        paths = seen.paths
        self._file.append(
            "path",
            {
                "path_pulse": paths.pulse,
                "delay": paths.delay_s,
                "gain_i": paths.gain.real,
                "gain_q": paths.gain.imag,
                "range_rate": paths.range_rate_mps,
                "incidence": paths.incidence_rad,
                "surface": paths.surface,
                "hit": paths.hit_m,
            },
        )

    def finish(self, comparison: Comparison) -> None:
        """Close the file."""
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()
