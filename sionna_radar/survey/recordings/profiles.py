"""Recording the range profiles around the echoes of a survey."""

from pathlib import Path
from typing import Any

import numpy as np

from sionna_radar.accuracy.truth import Comparison
from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.survey.preparation import Prepared
from sionna_radar.survey.recordings.pulse_columns import new_recording, write_pulses
from sionna_radar.survey.sensors.sensor import Observation


class ProfileRecorder:
    """Writes the profiles of each block: a contiguous ragged array of CF, `row_size` values of `power` a profile."""

    def __init__(self, path: Path, prepared: Prepared) -> None:
        self._file = file = new_recording(path, prepared, "profiles", "range profiles of a simulated FMCW radar")
        self._sensor = prepared.scenario.sensor
        file.dimension("profile")
        file.dimension("value")
        power_unit = "1" if prepared.local.radar.snr_db is not None else "W"

        def column(name: str, kind: type, long_name: str, units: str, **attributes: Any) -> None:
            file.variable(name, ("profile",), dtype=np.dtype(kind), long_name=long_name, units=units, **attributes)

        column("profile_pulse", np.int64, "pulse of the profile", "1", instance_dimension="pulse")
        column("first_cell", np.int64, "range cell of the profile's first value", "1")
        column("row_size", np.int64, "values of the profile", "1", sample_dimension="value")
        column("noise", np.float64, "power of the receiver's noise in a cell", power_unit)
        file.variable(
            "power",
            ("value",),
            dtype=np.dtype(np.float32),
            long_name="power of a range cell, calibrated: a beat of power P peaks at P; ranges with Doppler shift",
            units=power_unit,
            cell_m=prepared.receiver.chirp.range_resolution_m,
        )

    def write(self, pulses: Pulses, seen: Observation) -> None:
        """Write a block of pulses and its profiles."""
        write_pulses(self._file, pulses)
        profiles = seen.profiles
        if profiles is None:
            message = f"{self._sensor!r}, as it is set, makes no range profiles to record; record 'paths' instead"
            raise ScenarioError([Problem("sensor", message)])
        self._file.append(
            "profile",
            {
                "profile_pulse": profiles.pulse,
                "first_cell": profiles.first,
                "row_size": np.diff(profiles.start),
                "noise": profiles.noise,
            },
        )
        self._file.append("value", {"power": profiles.power})

    def finish(self, comparison: Comparison) -> None:
        """Close the file."""
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()
