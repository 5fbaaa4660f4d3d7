"""The command line: `sionna-radar COMMAND`.

Exit codes: 0 done, 2 bad input (one clear error on standard error, nothing written), 130 and 143 interrupted by Ctrl-C
or SIGTERM, 1 anything else: engines that cannot run, workers that are lost, a sweep with
cells that cannot be flown, results that had to go elsewhere. The heavy libraries are imported inside the commands, so
that `--help` answers at once.
"""

import inspect
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from sionna_radar.cli import commands, recordings, tools
from sionna_radar.foundation.errors import BackendError, KeptElsewhereError, RadarError, WorkersLostError

# The commands as `--help` lists them, by task.
TASKS: dict[str, tuple[tuple[str, Callable[..., None]], ...]] = {
    "Begin": (
        ("demo", commands.demo),
        ("init", tools.init),
        ("plan", tools.plan),
        ("validate", tools.validate),
        ("show", tools.show),
    ),
    "Simulate": (
        ("run", commands.run_command),
        ("image", commands.image),
        ("range-doppler", commands.range_doppler),
        ("link", commands.link),
        ("crosscheck", commands.crosscheck),
    ),
    "Study": (
        ("design", commands.design),
        ("sweep", commands.sweep),
        ("merge", commands.merge),
        ("budget", commands.budget),
        ("compare", tools.compare),
    ),
    "Real data": (
        ("process", recordings.process_command),
        ("twin", recordings.twin_command),
        ("calibrate", recordings.calibrate_command),
        ("fit-materials", tools.fit_materials_command),
        ("log", tools.log_command),
    ),
    "Reference": (
        ("scenes", tools.scenes),
        ("presets", tools.presets),
        ("fit", tools.fit),
        ("schema", tools.schema),
        ("doctor", tools.doctor),
    ),
}


class CommandsByTask(TyperGroup):
    """Commands whose `--help` lists them by task, each with its whole first line."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names in the order of `TASKS`."""
        return [name for listed in TASKS.values() for name, _ in listed]

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the sections of the list."""
        for task, listed in TASKS.items():
            with formatter.section(task):
                formatter.write_dl([(name, (inspect.getdoc(call) or "").partition("\n\n")[0]) for name, call in listed])


app = typer.Typer(
    cls=CommandsByTask,
    help="Simulate airborne millimetre-wave terrain radar, from ray-traced fields to a DEM and its error.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    # Rich takes longer to import than anything else that `--help` needs.
    rich_markup_mode=None,
)
for _listed in TASKS.values():
    for _name, _call in _listed:
        app.command(name=_name)(_call)


def main() -> None:
    """Run the command line."""
    from sionna_radar.foundation.progress import tune_heaps
    from sionna_radar.report.terminal import print_on_any_encoding

    tune_heaps()
    print_on_any_encoding()
    with _errors_reported():
        app()


def _print_version(wanted: bool) -> bool:
    if wanted:
        import sionna_radar

        typer.echo(f"sionna-radar {sionna_radar.__version__}")
        raise typer.Exit
    return wanted


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_print_version, help="Print the version and exit.")
    ] = False,
) -> None:
    # Only declares --version, which its own callback answers; a docstring would replace the program's help.
    pass


def _message(error: RadarError) -> str:
    """Return the line of an error, with the notes that it collected on its way up."""
    return "; ".join([f"error: {error}", *getattr(error, "__notes__", [])])


@contextmanager
def _errors_reported() -> Iterator[None]:
    """Turn errors of the user's making into one message and exit code 2."""
    from sionna_radar.report.terminal import printable

    try:
        yield
    except (BackendError, KeptElsewhereError, WorkersLostError) as error:
        typer.echo(printable(_message(error)), err=True)
        sys.exit(1)
    except RadarError as error:
        typer.echo(printable(_message(error)), err=True)
        sys.exit(2)
