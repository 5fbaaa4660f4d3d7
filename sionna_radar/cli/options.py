"""Arguments and options that several commands share."""

from pathlib import Path
from typing import Annotated

import typer

from sionna_radar.foundation.errors import BackendError, Problem, ScenarioError
from sionna_radar.report.survey.contents import PointsFile


def complete_scenario(incomplete: str) -> list[str]:
    """Return the scenarios, shipped ones and TOML files, that a word may become."""
    from sionna_radar.scenario.loading import shipped_scenarios

    folder = Path(incomplete).parent
    files = [str(path) for path in folder.glob("*.toml")] if folder.is_dir() else []
    return [name for name in [*shipped_scenarios(), *files] if name.startswith(incomplete)]


def complete_key(incomplete: str) -> list[str]:
    """Return the dotted keys that the left side of an assignment may become."""
    from sionna_radar.scenario.reference import dotted_keys

    return [f"{key}=" for key in dotted_keys() if key.startswith(incomplete)]


def _choose_backend(name: str | None) -> str | None:
    """Choose what rays are traced with, before anything loads the ray tracer."""
    if name is not None:
        from sionna_radar.raytracer.backend import use_backend

        try:
            use_backend(name)
        except BackendError as error:
            raise ScenarioError([Problem("--backend", str(error))], "command line") from error
    return name


BackendOption = Annotated[
    str | None,
    typer.Option(
        "--backend",
        metavar="auto|llvm|cuda",
        help="What traces the rays: the CPU (llvm), a GPU (cuda), or a GPU where there is one (auto, the default).",
        callback=_choose_backend,
    ),
]
ScenarioArgument = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO", help="A TOML file, or the name of a shipped scenario.", autocompletion=complete_scenario
    ),
]
OutputOption = Annotated[
    Path | None, typer.Option("-o", "--output", metavar="DIR", help="Where results go; default results/NAME.")
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Replace a value by its dotted key, e.g. radar.antenna.beamwidth_deg=4; KEY=none removes it.",
        autocompletion=complete_key,
    ),
]
SetFileOption = Annotated[
    list[Path] | None,
    typer.Option("--set-file", metavar="FILE", help="Merge the tables of a TOML file into the scenario, before --set."),
]
SeedOption = Annotated[int | None, typer.Option(help="Replace the scenario's seed.")]
BlockOption = Annotated[
    int | None, typer.Option(min=1, help="Pulses simulated at once; changes speed and memory, never the result.")
]
MapOption = Annotated[
    bool,
    typer.Option(
        "--map-coordinates/--local-coordinates",
        help="Coordinates in figures: those of the map where the terrain has a place on it, or local ones.",
    ),
]
ReportOption = Annotated[
    bool,
    typer.Option(
        "--report/--no-report", help="Write report.html, a page of all results for a browser, or leave it out."
    ),
]
PointsOption = Annotated[
    list[PointsFile] | None,
    typer.Option(
        "--points", help="Format of the points; repeat for several. Default: laz and csv. Parquet needs pyarrow."
    ),
]
NetworkOption = Annotated[
    bool,
    typer.Option("--allow-network", help="Let terrain.path be an address (https://, s3://, ...) and read it there."),
]
ResumeOption = Annotated[
    bool, typer.Option("--resume", help="Go on with the finished parts that an interrupted run left in the folder.")
]
WorkersOption = Annotated[
    int | None,
    typer.Option("--workers", metavar="N", help="Share the work among N processes of this machine; needs dask."),
]
SchedulerOption = Annotated[
    str | None,
    typer.Option("--scheduler", metavar="ADDRESS", help="Share the work among a dask cluster: tcp://HOST:PORT."),
]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
