"""Recorders: what is written while a survey flies, by its kind.

A recording appears whole or not at all: it grows in a staging folder beside its place, and is moved there at the end.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Literal

from sionna_radar.foundation.errors import OutputError, Problem, ScenarioError
from sionna_radar.foundation.staging import abandoned, staged
from sionna_radar.scenario.averaging import refuse_average
from sionna_radar.survey.preparation import Prepared
from sionna_radar.survey.recording import Recorder, SampleType
from sionna_radar.survey.recordings.profiles import ProfileRecorder
from sionna_radar.survey.recordings.signals import SignalRecorder
from sionna_radar.survey.recordings.traced_paths import PathRecorder

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
