"""The `--record` option, and the command that processes recordings."""

from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, get_args

import typer

from sionna_radar.cli.session import (
    RECORDING,
    TEAM,
    ApplyShiftOption,
    BlockOption,
    FiguresOption,
    Listed,
    MapOption,
    MeasuredHeights,
    ReferenceOption,
    ReferenceSigmaOption,
    ReportOption,
    Session,
    command,
)
from sionna_radar.execution.staging import abandoned, staged
from sionna_radar.foundation.errors import OutputError, ScenarioError
from sionna_radar.foundation.input_file import shown

if TYPE_CHECKING:
    from sionna_radar.cli.session import OpenCheckpoints
    from sionna_radar.survey.observation import SampleType
    from sionna_radar.survey.result import Processed

KINDS = ("signals", "paths", "profiles", "cube")
RecordOption = Annotated[
    list[str] | None,
    typer.Option(
        "--record",
        metavar="WHAT",
        help="Record signals, paths, profiles or the cube of an array while flying: a kind alone goes with the results "
        "as KIND.nc, KIND=FILE.nc or FILE.nc (signals, unless the file is named after a kind) to a file of its own, "
        "cube=FILE.bin to a raw capture with its FILE.cfg. Repeatable.",
    ),
]
RecordAsOption = Annotated[
    str,
    typer.Option(
        "--record-as",
        metavar="TYPE",
        help="Samples of recorded signals: float64 (the same result again, bit for bit), float32 or int16.",
    ),
]


def parse_records(wanted: list[str] | None) -> tuple[dict[str, Path], list[str]]:
    """Return recording files by kind, and kinds within the output folder; ScenarioError for wrong or repeated ones."""
    files: dict[str, Path] = {}
    inside: list[str] = []
    for text in wanted or []:
        kind, separator, name = text.partition("=")
        if not separator and text.endswith(".nc"):
            kind, name = Path(text).stem if Path(text).stem in KINDS else "signals", text
        if kind not in KINDS or (separator and not name.endswith((".nc", ".bin") if kind == "cube" else ".nc")):
            message = f"{text!r} is not recorded; give {', '.join(KINDS)}, or one of them with =FILE.nc"
            raise ScenarioError.of_option("--record", message)
        if kind in files or kind in inside:
            raise ScenarioError.of_option("--record", f"{kind} are wanted twice; give them once")
        if name:
            files[kind] = Path(name)
        else:
            inside.append(kind)
    return files, inside


def parse_sample_type(text: str, kinds: Iterable[str]) -> "SampleType":
    """Return the sample type of recorded signals; ScenarioError if it is unknown or no signals are recorded."""
    from sionna_radar.survey.observation import SampleType

    known: tuple[SampleType, ...] = get_args(SampleType)
    if text != known[0] and not {"signals", "cube"} & set(kinds):
        message = f"{text!r} has no effect without --record signals (or cube); add it, or leave this out"
        raise ScenarioError.of_option("--record-as", message)
    for name in known:
        if text == name:
            return name
    raise ScenarioError.of_option("--record-as", f"{text!r} is unknown; give one of {', '.join(known)}")


@contextmanager
def with_the_results(kinds: list[str], directory: Path) -> Iterator[dict[str, Path]]:
    """Yield temporary files for recordings that will move into the output folder once it is written."""
    if not kinds:
        yield {}
        return
    place = next(parent for parent in directory.expanduser().resolve().parents if parent.is_dir())
    for _ in abandoned(place):
        pass  # leftovers of killed runs are removed
    with ExitStack() as stack:
        try:
            folder = stack.enter_context(staged(place))
        except OSError as error:
            message = f"{place} cannot be written ({error.strerror}); free some space or name another folder with -o"
            raise OutputError(message) from error
        yield {kind: folder / f"{kind}.nc" for kind in kinds}


@command(*RECORDING, *TEAM)
def process_command(
    session: Session,
    recording: Annotated[
        Path,
        typer.Argument(
            metavar="RECORDING", help="A netCDF file of beat signals, or a TOML description of any recording."
        ),
    ],
    block_size: BlockOption = None,
    map_coordinates: MapOption = True,
    report: ReportOption = True,
    figures: FiguresOption = False,
    reference: ReferenceOption = None,
    reference_sigma: ReferenceSigmaOption = 0.0,
    apply_shift: ApplyShiftOption = False,
    describe: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Instead write the TOML description of a raw capture (.bin) from its chirp configuration (.cfg or "
            ".mmwave.json): beside the capture, or to the file of -o.",
        ),
    ] = None,
) -> None:
    """Process recorded or measured beat signals into ranges, points and a DEM."""
    if describe is not None:
        _describe(session, recording, describe)
        return
    from sionna_radar.execution.execution import BLOCK_SIZE
    from sionna_radar.report.coordinates import Coordinates
    from sionna_radar.report.files.contents import Figures
    from sionna_radar.report.survey.processed import processed_document
    from sionna_radar.survey.recording_source import identity_of, open_recording
    from sionna_radar.survey.reprocessing import process

    coordinates, size = Coordinates.MAP if map_coordinates else Coordinates.LOCAL, block_size or BLOCK_SIZE
    drawn = Figures.PNG if figures else Figures.NONE
    heights = MeasuredHeights(reference, reference_sigma, apply_shift)

    def fly(keep: "OpenCheckpoints") -> "Processed":
        """Process the recording, and compare its DEM with the reference."""
        if heights.path is not None:
            # A reference that does not fit is refused before a long processing.
            with open_recording(recording, session.overrides) as source:
                heights.check(source.mappable_grid())
        with session.execution(keep, identity_of(recording, session.overrides, size), size) as execution:
            processed = process(recording, session.overrides, execution=execution)
        return heights.compared(processed)

    document = processed_document(coordinates, drawn)
    session.produce(fly, document, report=report, products=[coordinates, drawn.name, *heights.products])


def _describe(session: Session, capture: Path, config: Path) -> None:
    """Write the description of a raw capture, and say what it assumes."""
    from sionna_radar.readers.captures.capture_description import describe_capture

    if session.overrides:
        raise ScenarioError.of_option("--describe", "takes no --set; change the description it writes")
    written = describe_capture(capture, config, session.output)
    if not session.quiet:
        for sentence in written.assumed:
            typer.echo(f"assumed: {sentence}")
        path = shown(written.path)
        typer.echo(f"description in {path}; process it with: sionna-radar process {path}")


COMMANDS = (Listed("Real data", "process", process_command),)
