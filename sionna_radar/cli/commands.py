"""The commands that fly one survey: `demo` and `run`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sionna_radar.cli.recordings import RecordAsOption, RecordOption, parse_records, parse_sample_type, with_the_results
from sionna_radar.cli.session import (
    SCENARIO,
    TEAM,
    ApplyShiftOption,
    BackendOption,
    BlockOption,
    FiguresOption,
    Listed,
    MapOption,
    MeasuredHeights,
    OutputOption,
    PointsOption,
    QuietOption,
    ReferenceOption,
    ReferenceSigmaOption,
    ReportOption,
    ResumeOption,
    Session,
    Supplement,
    command,
    log_to_stderr,
    progress_shown,
)
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.input_file import shown
from sionna_radar.report.files.contents import FIGURES, POINTS_FILES, Figures, PointsFile

if TYPE_CHECKING:
    from sionna_radar.cli.session import OpenCheckpoints
    from sionna_radar.scenario import Scenario
    from sionna_radar.survey.preparation import Prepared
    from sionna_radar.survey.result import Survey

DEMO, CITY = "demo", "san_francisco"


def run_survey(
    session: Session,
    block_size: BlockOption = None,
    map_coordinates: MapOption = True,
    report: ReportOption = True,
    figures: FiguresOption = False,
    points: PointsOption = None,
    record: RecordOption = None,
    record_as: RecordAsOption = "float64",
    reference: ReferenceOption = None,
    reference_sigma: ReferenceSigmaOption = 0.0,
    apply_shift: ApplyShiftOption = False,
) -> None:
    """Simulate a scenario, and write its DEM, points, errors and page."""
    if record and (session.workers is not None or session.scheduler is not None):
        message = "recording works in one process only; leave out --workers and --scheduler"
        raise ScenarioError.of_option("--record", message)
    heights, checked = MeasuredHeights(reference, reference_sigma, apply_shift), session.load()

    from sionna_radar.execution.execution import BLOCK_SIZE, Execution
    from sionna_radar.report.coordinates import Coordinates
    from sionna_radar.report.survey.products import survey_document
    from sionna_radar.scenario.loading import identity
    from sionna_radar.survey.chain import run
    from sionna_radar.survey.preparation import prepare

    coordinates = Coordinates.MAP if map_coordinates else Coordinates.LOCAL
    files, drawn = points or POINTS_FILES, Figures.PNG if figures else Figures.NONE
    if PointsFile.PARQUET in files:
        from sionna_radar.report.files.points_table import check_parquet

        check_parquet()

    def fly(keep: "OpenCheckpoints") -> "Survey":
        """Fly the scenario, in one process if signals are recorded, and compare the DEM with the reference."""
        files, size = outside | inside, block_size or BLOCK_SIZE
        survey: Scenario | Prepared = checked
        if heights.path is not None:
            # A reference that does not fit is refused before a long flight.
            survey = prepare(checked)
            heights.check(survey.mapper.grid)
        if files:
            execution = Execution(block_size=size)
            return heights.compared(run(survey, recordings=files, sample_type=sample_type, execution=execution))
        with session.execution(keep, identity(checked, size), size) as execution:
            return heights.compared(run(survey, execution=execution))

    def products(kind: Figures) -> list[str]:
        """Return the choice of output files with figures of a kind."""
        return [coordinates, *files, kind.name, *heights.products]

    def draw(folder: Path) -> list[Path]:
        """Draw the figures of a finished survey into its folder."""
        from sionna_radar.report.survey.finished import draw_figures

        return draw_figures(folder, coordinates)

    # The folder holds all that is drawn but the course of a refined navigation.
    drawable = figures and PointsFile.CSV in files and checked.processing.navigation != "refined"
    outside, kinds = parse_records(record)
    sample_type = parse_sample_type(record_as, [*outside, *kinds])
    with with_the_results(kinds, session.directory("")) as inside:
        session.produce(
            fly,
            survey_document(coordinates, files, drawn, inside),
            report=report,
            products=products(drawn),
            supplement=Supplement(products(Figures.NONE), draw) if drawable else None,
        )
    if checked.radar.scan.mode == "side_looking" and not session.quiet:
        typer.echo(f"this radar looks to the side: `sionna-radar image {session.scenario}` makes its image")


def demo(
    output: OutputOption = None,
    map_coordinates: MapOption = True,
    report: ReportOption = True,
    figures: FiguresOption = True,
    resume: ResumeOption = False,
    backend: BackendOption = None,
    quiet: QuietOption = False,
) -> None:
    """Simulate a survey of four buildings on hills, and write its results and figures."""
    log_to_stderr(quiet)
    session = Session(scenario=DEMO, output=output or Path("results/demo"), quiet=quiet, resume=resume)
    run_survey(session, map_coordinates=map_coordinates, report=report, figures=figures)
    if not quiet:
        typer.echo(f"a whole city takes some five times as long: sionna-radar run {CITY} --figures")


def figures_command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A folder of results of `run` or `demo`.")],
    map_coordinates: MapOption = True,
    quiet: QuietOption = False,
) -> None:
    """Draw the figures of a finished survey into its folder, for print."""
    log_to_stderr(quiet)
    from sionna_radar.report.coordinates import Coordinates
    from sionna_radar.report.survey.finished import draw_figures

    with progress_shown(quiet):
        drawn = draw_figures(folder, Coordinates.MAP if map_coordinates else Coordinates.LOCAL)
    if not quiet:
        typer.echo(f"{len(drawn)} figures in {shown(folder / FIGURES)}")


COMMANDS = (
    Listed("Begin", "demo", demo),
    Listed("Simulate", "run", command(*SCENARIO, *TEAM)(run_survey)),
    Listed("Simulate", "figures", figures_command),
)
