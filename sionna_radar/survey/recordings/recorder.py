"""Recorders of a survey in flight, by kind: the range profiles around its echoes, and its traced paths.

A recording appears whole or not at all: it grows in a staging folder beside its place, and is moved there at the end.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Literal

import numpy as np

from sionna_radar.accuracy.truth import Comparison
from sionna_radar.execution.checkpoints import abandoned, staged
from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.errors import OutputError, Problem, ScenarioError
from sionna_radar.scenario.radar import refuse_average
from sionna_radar.survey.observation import Recorder, SampleType
from sionna_radar.survey.preparation import Prepared
from sionna_radar.survey.recordings.signals import SignalRecorder, new_recording, write_pulses
from sionna_radar.survey.sensors.sensor import Observation
from sionna_radar.tracing.paths import BOUNCED, TARGET, VOLUME


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


Kind = Literal["signals", "paths", "profiles"]
KINDS: tuple[Kind, ...] = ("signals", "paths", "profiles")


@contextmanager
def recorders(
    wanted: Mapping[str, Path], prepared: Prepared, sample_type: SampleType = "float64"
) -> Iterator[Sequence[Recorder]]:
    """Yield the recorders of a survey; their files are in place when the block ends without an error.

    Parameters
    ----------
    wanted:
        Files by the kind of recording: "signals", "paths" or "profiles".
    prepared:
        The survey.
    sample_type:
        How the samples of beat signals are kept.

    Raises
    ------
    ScenarioError
        There is no such kind.
    OutputError
        A file exists, or its folder cannot be written.

    """
    files = checked_files(wanted)
    refuse_average(prepared.scenario.processing, "a recording")
    if "signals" in files and prepared.angle is not None:
        message = (
            f"{prepared.scenario.processing.angle!r} needs all receivers, and only the first one's signals are kept; "
        )
        raise ScenarioError([Problem("processing.angle", message + "set 'off' to record")])
    makers: dict[str, Callable[[Path], Recorder]] = {
        "signals": lambda path: SignalRecorder(path, prepared, sample_type),
        "paths": lambda path: PathRecorder(path, prepared),
        "profiles": lambda path: ProfileRecorder(path, prepared),
    }
    with ExitStack() as stack:
        made, places = [], []
        try:
            for kind, path in files.items():
                folder = stack.enter_context(staged(path.parent))
                recorder = makers[kind](folder / path.name)
                stack.callback(recorder.close)
                made.append(recorder)
                places.append((folder / path.name, path))
            yield made
            for written, path in places:
                if path.exists():
                    message = f"recording {path} has come into being during the flight; name another file"
                    raise OutputError(message)
                written.rename(path)
        except OutputError:
            raise
        except OSError as error:
            names = ", ".join(str(path) for path in files.values())
            reason = error.strerror or str(error)
            message = f"recording {names} cannot be written ({reason}); free some space or name another file"
            raise OutputError(message) from error


def checked_files(wanted: Mapping[str, Path]) -> dict[str, Path]:
    """Return the resolved paths of recordings by their kinds, or refuse them before any work is done.

    Raises ScenarioError for an unknown kind, and OutputError for a file that exists or cannot be made.
    """
    files = {kind: _checked(kind, path) for kind, path in wanted.items()}
    if len(set(files.values())) < len(files):
        message = f"recordings {', '.join(files)} go to one file; give each one of its own"
        raise OutputError(message)
    return files


def _checked(kind: str, path: Path) -> Path:
    if kind not in KINDS:
        raise ScenarioError([Problem("record", f"{kind!r} is not recorded; give one of {', '.join(KINDS)}")], "run")
    try:
        path = path.expanduser().resolve()
        if path.exists():
            message = f"recording {path} exists already; move it away or name another file"
            raise OutputError(message)
        if not path.parent.is_dir():
            message = f"recording {path} cannot be written: there is no folder {path.parent}; make it first"
            raise OutputError(message)
        for _ in abandoned(path.parent):
            pass  # leftovers of killed runs are removed
    except (RuntimeError, ValueError) as error:
        message = f"recording {path} cannot be written ({error}); name another file"
        raise OutputError(message) from error
    return path
