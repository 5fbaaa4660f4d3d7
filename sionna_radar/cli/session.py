"""Common part of scenario commands: options; load a scenario, check the output folder, simulate, print and write."""

import inspect
import logging
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from sionna_radar.foundation.errors import BackendError, ScenarioError, named_after
from sionna_radar.foundation.input_file import allow_network, regular_file, shown
from sionna_radar.report.files.contents import PointsFile, Report
from sionna_radar.report.files.folder import check_output
from sionna_radar.report.files.manifest import finished_as, note_run

if TYPE_CHECKING:
    from sionna_radar.execution.checkpoints import Checkpoints
    from sionna_radar.execution.execution import Execution
    from sionna_radar.foundation.raster import Grid
    from sionna_radar.report.study_document import StudyDocument
    from sionna_radar.scenario import Scenario
    from sionna_radar.survey.result import Processed, Survey

    Flown = TypeVar("Flown", Survey, Processed)

Result = TypeVar("Result")
# Opens or resumes the checkpoints of a run described by a JSON document.
OpenCheckpoints = Callable[[Mapping[str, Any]], "Checkpoints"]
# Key of a run's choice of output files, on which checkpoints do not depend.
PRODUCTS = "choice of products"
MAX_REFERENCE_BYTES = 200_000_000_000


@dataclass(frozen=True)
class MeasuredHeights:
    """The options of a comparison with measured heights; raises InputFileError at once for a missing file."""

    path: Path | None = None
    sigma_m: float = 0.0
    apply_shift: bool = False

    def __post_init__(self) -> None:
        if self.path is not None:
            regular_file(self.path, "--reference", "give a GeoTIFF, LAS, LAZ or CSV file", MAX_REFERENCE_BYTES)

    @property
    def products(self) -> list[str]:
        """Choices that the result depends on."""
        return [] if self.path is None else [str(self.path), str(self.sigma_m), str(self.apply_shift)]

    def check(self, grid: "Grid") -> None:
        """Raise InputFileError if the heights cannot be compared with a DEM on a grid."""
        if self.path is not None:
            from sionna_radar.accuracy.reference import read_reference

            read_reference(self.path, grid, self.sigma_m)

    def compared(self, result: "Flown") -> "Flown":
        """Return a result with the comparison, if it is asked for."""
        if self.path is None:
            return result
        return result.with_reference(self.path, sigma_m=self.sigma_m, apply_shift=self.apply_shift)


@dataclass(frozen=True)
class Supplement:
    """Files that can be added to a result that lacks nothing else.

    products: choice of output files without them. add: writes them into the folder of the result, and returns them.
    """

    products: Sequence[str]
    add: Callable[[Path], Sequence[Path]]


@dataclass(frozen=True, kw_only=True)
class Session:
    """One call of a command on a scenario, a recording or another subject.

    scenario: a file, or the name of a shipped scenario; names the default output folder.
    overrides: values by dotted keys. network: whether files may be read from the network.
    resume: whether to continue from checkpoints in the output folder.
    workers, scheduler: number of local processes, or address of a dask cluster.
    """

    scenario: str
    output: Path | None = None
    overrides: dict[str, object] = field(default_factory=dict)
    quiet: bool = False
    network: bool = False
    resume: bool = False
    workers: int | None = None
    scheduler: str | None = None

    @contextmanager
    def reach(self) -> Iterator[None]:
        """Apply the network permission to file access, and name the scenario in errors."""
        with named_after(shown(Path(self.scenario))), allow_network() if self.network else nullcontext():
            yield

    @contextmanager
    def execution(
        self, keep: OpenCheckpoints, described: Mapping[str, Any], block_size: int | None = None
    ) -> "Iterator[Execution]":
        """Yield the execution of a run on the workers, with checkpoints that hold for the inputs `described`."""
        from sionna_radar.execution.cluster import open_workers
        from sionna_radar.execution.execution import BLOCK_SIZE, Execution

        with open_workers(self.workers, self.scheduler) as team:
            yield Execution(block_size=block_size or BLOCK_SIZE, workers=team, checkpoints=keep(described))

    def load(self) -> "Scenario":
        """Return the scenario."""
        from sionna_radar.scenario import load_scenario

        return load_scenario(self.scenario, self.overrides)

    def directory(self, suffix: str) -> Path:
        """Return the output folder; the default is the scenario's name with a suffix."""
        return self.output or Path("results") / f"{Path(self.scenario).stem}{suffix}"

    def produce(
        self,
        compute: "Callable[[OpenCheckpoints], Result]",
        document: "StudyDocument[Result]",
        *,
        report: bool | None = None,
        exit_code: Callable[[Result], int] = lambda _: 0,
        products: Sequence[str] = (),
        supplement: Supplement | None = None,
    ) -> None:
        """Simulate, print and write a result; with `resume`, skip a run whose result is in the folder already.

        compute: returns the result; its argument opens the checkpoints.
        report: whether to write the page, `report.html`, where that is a choice; products: choice of output files.
        supplement: those of the products that `resume` adds to a result in the folder, without a simulation.
        exit_code: exit code of a result; may print its reason on standard error.
        """
        directory, described = check_output(self.directory(document.suffix), document.marker), dict[str, Any]()
        contents = Report.NONE if report is False else Report.PAGE
        with ExitStack() as until_written:

            def keep(run: Mapping[str, Any]) -> "Checkpoints":
                """Open the checkpoints of a run in its folder, unless the run is finished."""
                from sionna_radar.execution.checkpoints import has_checkpoints, open_checkpoints
                from sionna_radar.execution.workers import versions
                from sionna_radar.raytracer.backend import chosen_backend

                # GPU and CPU round differently.
                needed = {"command": document.marker, "version": versions(), "backend": chosen_backend(), **run}
                page = [] if report is None else [contents.name]
                described.update({**needed, PRODUCTS: [*products, *page]})
                if self.resume and not has_checkpoints(directory):
                    self._end_if_finished(directory, described, page, supplement)
                return until_written.enter_context(open_checkpoints(directory, needed, resume=self.resume))

            with progress_shown(self.quiet), self.reach():
                result = compute(keep)
            if not self.quiet:
                # Drawing may take longer than the simulation: print first.
                document.show(result)
                sys.stdout.flush()
            with progress_shown(self.quiet):
                written = document.write(result, directory, report=contents)
            code = exit_code(result)
            if described:
                note_run(directory, described, code)
        if not self.quiet:
            typer.echo(f"{len(written)} files in {shown(directory)}")
        if code:
            raise typer.Exit(code)

    def _end_if_finished(
        self, directory: Path, described: Mapping[str, Any], page: list[str], supplement: Supplement | None
    ) -> None:
        """Exit with the code of an identical earlier run in the folder, with files added that alone it lacks."""
        code, done = finished_as(directory, described, PRODUCTS), "nothing to do"
        if code is None and supplement is not None:
            lacking = {**described, PRODUCTS: [*supplement.products, *page]}
            code = finished_as(directory, lacking, PRODUCTS)
            if code is not None:
                done = f"{len(supplement.add(directory))} files added"
                note_run(directory, described, code)
        if code is not None:
            if not self.quiet:
                typer.echo(f"the result of this run is in {shown(directory)} already; {done}")
            raise typer.Exit(code)


@contextmanager
def progress_shown(quiet: bool) -> "Iterator[None]":
    """Show progress on standard error, unless quiet."""
    from sionna_radar.foundation.progress import progress_to
    from sionna_radar.report.terminal import shown_progress

    if quiet:
        yield
        return
    from sionna_radar.foundation.machine_code import on_first_compilation

    on_first_compilation(lambda: typer.echo("compiling, first run only", err=True))
    with shown_progress() as progress, progress_to(progress):
        yield


def log_to_stderr(quiet: bool = False) -> None:
    """Send warnings (with `quiet` only errors) to standard error, each once; what workers do is told each time."""
    from sionna_radar.report.terminal import printable

    class Literal(logging.Formatter):
        def format(self, record: logging.LogRecord) -> str:
            return printable(super().format(record))

    said: set[str] = set()

    def is_new(record: logging.LogRecord) -> bool:
        text = record.getMessage()
        known = text in said and not record.name.startswith("sionna_radar.execution")
        said.add(text)
        return not known

    logger = logging.getLogger("sionna_radar")
    if not logger.handlers:
        handler = logging.StreamHandler(sys.stderr)
        handler.setFormatter(Literal("%(levelname)s: %(message)s"))
        logger.addHandler(handler)
    for each in logger.handlers:
        # Set on the handler, not the logger: results record warnings even if they are not shown.
        each.setLevel(logging.ERROR if quiet else logging.WARNING)
        each.filters = [is_new]


def parse_pair(option: str, text: str, separator: str, form: str) -> tuple[float, float]:
    """Return the two numbers of a command-line option. Raises ScenarioError if the text is not such a pair."""
    try:
        first, second = (float(word) for word in text.lower().split(separator))
    except ValueError as error:
        raise ScenarioError.of(option, f"{text!r} is not a pair of numbers; give {form}", "plan") from error
    return first, second


def complete_scenario(incomplete: str) -> list[str]:
    """Complete the name of a shipped scenario or a TOML file."""
    from sionna_radar.scenario.shipped import shipped_scenarios

    folder = Path(incomplete).parent
    files = [str(path) for path in folder.glob("*.toml")] if folder.is_dir() else []
    return [name for name in [*shipped_scenarios(), *files] if name.startswith(incomplete)]


def complete_key(incomplete: str) -> list[str]:
    """Complete a dotted key."""
    from sionna_radar.scenario.reference import dotted_keys

    return [f"{key}=" for key in dotted_keys() if key.startswith(incomplete)]


def _choose_backend(name: str | None) -> str | None:
    """Select the ray-tracing backend before the ray tracer is imported."""
    if name is not None:
        from sionna_radar.raytracer.backend import use_backend

        try:
            use_backend(name)
        except BackendError as error:
            raise ScenarioError.of_option("--backend", str(error)) from error
    return name


BackendOption = Annotated[
    str | None,
    typer.Option(
        "--backend",
        metavar="auto|llvm|cuda",
        help="Ray tracing on the CPU (llvm), on a GPU (cuda), or on a GPU if there is one (auto, the default).",
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
        help="Coordinates in figures: map coordinates if the terrain is georeferenced, or local metres.",
    ),
]
ReportOption = Annotated[
    bool,
    typer.Option(
        "--report/--no-report", help="Write report.html, a page of all results for a browser, or leave it out."
    ),
]
FiguresOption = Annotated[
    bool,
    typer.Option("--figures/--no-figures", help="Draw figures/*.png for print, or leave them to `figures DIR` later."),
]
ReferenceOption = Annotated[
    Path | None,
    typer.Option(
        "--reference",
        metavar="FILE",
        help="Measured heights to compare the DEM with: a GeoTIFF, a LAS or LAZ cloud, or CSV of x, y, z[, sigma].",
    ),
]
ReferenceSigmaOption = Annotated[
    float,
    typer.Option("--reference-sigma", metavar="M", min=0.0, help="Standard deviation of the reference's heights, m."),
]
ApplyShiftOption = Annotated[
    bool, typer.Option("--apply-shift", help="Take the estimated shift against the reference out before comparing.")
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
    bool, typer.Option("--resume", help="Continue an interrupted run from the checkpoints in its output folder.")
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


def session_of(
    scenario: ScenarioArgument,
    output: OutputOption = None,
    set_: SetOption = None,
    set_file: SetFileOption = None,
    seed: SeedOption = None,
    network: NetworkOption = False,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    resume: ResumeOption = False,
    backend: BackendOption = None,
    quiet: QuietOption = False,
) -> Session:
    """Return the session of a command line; --set takes precedence over --set-file."""
    from sionna_radar.scenario.overrides import parse_overrides, read_overrides

    del backend  # chosen by the option's callback
    log_to_stderr(quiet)
    overrides: dict[str, Any] = {}
    for file in set_file or []:
        overrides |= read_overrides(file)
    overrides |= parse_overrides(set_ or [])
    return Session(
        scenario=scenario,
        output=output,
        overrides=overrides if seed is None else {**overrides, "seed": seed},
        quiet=quiet,
        network=network,
        resume=resume,
        workers=workers,
        scheduler=scheduler,
    )


# Shared options of commands that simulate a scenario, that read a recording, and that have workers and resume.
SCENARIO = ("scenario", "output", "set_", "set_file", "seed", "network", "backend", "quiet")
RECORDING = ("output", "set_", "set_file", "quiet")
TEAM = ("workers", "scheduler", "resume")


def command(*names: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator: a command takes a `Session` first, and has these options of `session_of` beside its own.

    Options are listed in `--help` as: scenario and output, those of the command, the others. Without a scenario the
    session has the name of the command's own first argument.
    """

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        """Return the command with the shared options around its own."""
        shared = [o for o in inspect.signature(session_of).parameters.values() if o.name in names]
        _, *own = inspect.signature(function).parameters.values()

        @wraps(function)
        def called(**values: Any) -> None:
            given = {option.name: values.pop(option.name) for option in shared}
            if "scenario" not in given:
                subject = values[own[0].name]
                given["scenario"] = str(subject[0] if isinstance(subject, list) else subject)
            function(session_of(**given), **values)

        count = sum(option.name in ("scenario", "output") for option in shared)
        options = [*shared[:count], *own, *shared[count:]]
        if "scenario" not in names:
            options = [own[0], *(option for option in options if option is not own[0])]
        called.__dict__["__signature__"] = inspect.Signature(options)
        called.__annotations__ = {option.name: option.annotation for option in options}
        return called

    return decorate


@dataclass(frozen=True)
class Listed:
    """A command as `--help` lists it: under a task, by its name, with the first line of its docstring."""

    task: str
    name: str
    call: Callable[..., None]
