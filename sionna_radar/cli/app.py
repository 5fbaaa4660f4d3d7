"""The command line: `sionna-radar COMMAND`.

Exit codes: 0 done, 2 bad input (one clear error on standard error, nothing written), 130 and 143 interrupted by Ctrl-C
or SIGTERM, 1 anything else: engines that cannot run, workers that are lost, a sweep with
cells that cannot be flown, results that had to go elsewhere. The heavy libraries are imported inside the commands, so
that `--help` answers at once.
"""

import inspect
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from sionna_radar.cli import commands, recordings, tools
from sionna_radar.cli.discovery import installed_studies, study_module
from sionna_radar.cli.session import Listed
from sionna_radar.foundation.errors import BackendError, KeptElsewhereError, RadarError, WorkersLostError

# The sections of `--help`, in their order.
TASKS = ("Begin", "Simulate", "Study", "Real data", "Reference")
CORE = (*commands.COMMANDS, *recordings.COMMANDS, *tools.COMMANDS)


def listed() -> list[Listed]:
    """Return all commands by task: those of the simulator, then those of the studies that are here."""
    found = list(CORE)
    for study in installed_studies():
        found += getattr(study_module(study, "command"), "COMMANDS", ())
    return sorted(found, key=lambda command: TASKS.index(command.task))


LISTED = listed()


class CommandsByTask(TyperGroup):
    """Commands whose `--help` lists them by task, each with its whole first line."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names in the order of `TASKS`."""
        return [command.name for command in LISTED]

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the sections of the list."""
        for task in TASKS:
            with formatter.section(task):
                rows = [(each.name, inspect.getdoc(each.call) or "") for each in LISTED if each.task == task]
                formatter.write_dl([(name, text.partition("\n\n")[0]) for name, text in rows])


app = typer.Typer(
    cls=CommandsByTask,
    help="Simulate airborne millimetre-wave terrain radar, from ray-traced fields to a DEM and its error.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    # Rich takes longer to import than anything else that `--help` needs.
    rich_markup_mode=None,
)
for _command in LISTED:
    app.command(name=_command.name)(_command.call)


def main() -> None:
    """Run the command line."""
    from sionna_radar.foundation.memory import tune_heaps
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
    # Only declares --version; a docstring would replace the program's help.
    del version  # its own callback answers


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
