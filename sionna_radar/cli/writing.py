"""The commands that help to write a scenario: a commented one to begin with, and the schema for editors."""

from importlib import resources
from pathlib import Path
from typing import Annotated

import typer

from sionna_radar.foundation.errors import OutputError
from sionna_radar.foundation.input_file import shown


def add_to(app: typer.Typer) -> None:
    """Add the commands, in the order that `--help` lists them."""
    app.command()(init)
    app.command()(schema)


def init(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Where the scenario goes, such as my_survey.toml.")],
) -> None:
    """Write a commented scenario to begin with."""
    text = resources.files("sionna_radar.scenario").joinpath("template.toml").read_text(encoding="utf-8")
    path = file.expanduser()
    try:
        with path.open("x", encoding="utf-8", newline="\n") as new:
            new.write(text)
    except FileExistsError as error:
        message = f"{path} exists already; name another file"
        raise OutputError(message) from error
    except (OSError, ValueError) as error:
        message = f"{path} cannot be written ({getattr(error, 'strerror', None) or error}); name another file"
        raise OutputError(message) from error
    typer.echo(f"scenario in {shown(path)}; fly it with: sionna-radar run {shown(path)}")


def schema() -> None:
    """Print the JSON Schema of scenarios, by which editors complete keys and say what they mean."""
    import json

    from sionna_radar.scenario.schema import scenario_schema

    typer.echo(json.dumps(scenario_schema(), indent=2, ensure_ascii=False))
