"""Recorders of a survey in flight, by kind: beat signals, the range profiles around its echoes, and its traced paths.

A recording appears whole or not at all: it grows in a staging folder beside its place, and is moved there at the end.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from sionna_radar.accuracy.truth import Comparison
from sionna_radar.execution.staging import abandoned, staged
from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.errors import OutputError, ScenarioError
from sionna_radar.scenario.radar import refuse_average
from sionna_radar.survey.observation import Recorder, SampleType
from sionna_radar.survey.preparation import Prepared
from sionna_radar.survey.recordings.netcdf import NetcdfFile
from sionna_radar.survey.recordings.recording_head import new_recording, write_pulses
from sionna_radar.survey.recordings.signal_file import files_of
from sionna_radar.survey.recordings.signal_recorder import SignalRecorder
from sionna_radar.survey.sensors.sensor import Observation
from sionna_radar.tracing.paths import BOUNCED, FIRST_OBSTACLE, VOLUME


def _add_column(
    file: NetcdfFile,
    dimension: str,
    name: str,
    kind: type,
    long_name: str,
    units: str | None = None,
    **attributes: Any,
) -> None:
    file.variable(name, (dimension,), dtype=np.dtype(kind), long_name=long_name, units=units, **attributes)


class _Rows:
    """Writes rows of a netCDF file, of which none is known only at the end of the flight."""

    _file: NetcdfFile

    def finish(self, comparison: Comparison) -> None:
        """Close the file."""
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class ProfileRecorder(_Rows):
    """Writes the profiles of each block: a contiguous ragged array of CF, `row_size` values of `power` a profile."""

    def __init__(self, path: Path, prepared: Prepared) -> None:
        self._file = file = new_recording(path, prepared, "profiles", "range profiles of a simulated FMCW radar")
        self._sensor = prepared.scenario.sensor
        file.dimension("profile")
        file.dimension("value")
        power_unit = "1" if prepared.local.radar.snr_db is not None else "W"

        column = partial(_add_column, file, "profile")
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
            raise ScenarioError.of("sensor", message)
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


class PathRecorder(_Rows):
    """Writes the paths of each block: delay, complex gain, range rate, incidence, hit point and surface.

    An indexed ragged array of CF: `path_pulse` is the pulse of each path.
    """

    def __init__(self, path: Path, prepared: Prepared) -> None:
        self._file = file = new_recording(path, prepared, "paths", "paths of a simulated FMCW radar")
        file.dimension("path")
        names = [f"{number} {surface.name}" for number, surface in enumerate(prepared.world.scene.surfaces)]

        column = partial(_add_column, file, "path")
        column("path_pulse", np.int64, "pulse of the path", "1", instance_dimension="pulse")
        column("delay", np.float64, "two-way delay at the middle of the chirp", "s")
        column("gain_i", np.float32, "received over transmitted wave, real part; the phase excludes the delay", "1")
        column("gain_q", np.float32, "received over transmitted wave, imaginary part", "1")
        column("range_rate", np.float32, "range rate, positive when receding", "m s-1")
        column("incidence", np.float32, "angle between ray and surface normal; NaN for targets and volumes", "rad")
        column(
            "surface", np.int32, f"surface hit; {VOLUME} volume cell, {BOUNCED} two, {FIRST_OBSTACLE}... obstacle", "1",
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


Kind = Literal["signals", "paths", "profiles", "cube"]
KINDS: tuple[Kind, ...] = ("signals", "paths", "profiles", "cube")


@contextmanager
def recorders(
    wanted: Mapping[str, Path], prepared: Prepared, sample_type: SampleType = "float64"
) -> Iterator[Sequence[Recorder]]:
    """Yield the recorders of a survey by kind; their files are in place when the block ends without an error.

    Raises ScenarioError if there is no such kind, OutputError if a file exists, or its folder cannot be written.
    """
    files = checked_files(wanted)
    refuse_average(prepared.scenario.processing, "a recording")
    for kind, of_array in (("cube", True), ("signals", False), ("profiles", False)):
        if kind in files and (prepared.scenario.sensor == "mimo") != of_array:
            own = "sensor = 'mimo'" if of_array else "single chirps"
            raise ScenarioError.of("record", f"{kind!r} is of {own}; give another kind, or change the sensor")
    makers: dict[str, Callable[[Path], Recorder]] = {
        "signals": lambda path: SignalRecorder(path, prepared, sample_type),
        "paths": lambda path: PathRecorder(path, prepared),
        "profiles": lambda path: ProfileRecorder(path, prepared),
        "cube": lambda path: SignalRecorder(path, prepared, sample_type),
    }
    with ExitStack() as stack:
        made, places = [], []
        try:
            for kind, path in files.items():
                folder = stack.enter_context(staged(path.parent))
                recorder = makers[kind](folder / path.name)
                stack.callback(recorder.close)
                made.append(recorder)
                places += [(folder / file.name, file) for file in files_of(kind, path)]
            yield made
            for written, path in places:
                if path.exists():
                    raise OutputError(f"recording {path} has come into being during the flight; name another file")
                written.rename(path)
        except OutputError:
            raise
        except OSError as error:
            names = ", ".join(str(path) for path in files.values())
            reason = error.strerror or str(error)
            message = f"recording {names} cannot be written ({reason}); free some space or name another file"
            raise OutputError(message) from error


def checked_files(wanted: Mapping[str, Path]) -> dict[str, Path]:
    """Return the resolved paths of recordings by kind; ScenarioError for an unknown one, OutputError for a file."""
    files = {kind: _checked(kind, path) for kind, path in wanted.items()}
    if len(set(files.values())) < len(files):
        raise OutputError(f"recordings {', '.join(files)} go to one file; give each one of its own")
    return files


def _checked(kind: str, path: Path) -> Path:
    if kind not in KINDS:
        raise ScenarioError.of("record", f"{kind!r} is not recorded; give one of {', '.join(KINDS)}", "run")
    try:
        path = path.expanduser().resolve()
        for file in files_of(kind, path):
            if file.exists():
                raise OutputError(f"recording {file} exists already; move it away or name another file")
        if not path.parent.is_dir():
            raise OutputError(f"recording {path} cannot be written: there is no folder {path.parent}; make it first")
        for _ in abandoned(path.parent):
            pass  # leftovers of killed runs are removed
    except (RuntimeError, ValueError) as error:
        raise OutputError(f"recording {path} cannot be written ({error}); name another file") from error
    return path
