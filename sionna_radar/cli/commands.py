"""The commands that simulate: surveys, studies, images, range-Doppler maps and link budgets."""

from collections.abc import Sequence
from functools import partial
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
    command,
    complete_key,
    log_to_stderr,
    progress_shown,
)
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.report.files.contents import MARKER, POINTS_FILES, RUNS_FILES, Keep, PointsFile, Report, RunsFile

if TYPE_CHECKING:
    from sionna_radar.cli.session import OpenCheckpoints
    from sionna_radar.scenario import Scenario
    from sionna_radar.studies.budget import Budget
    from sionna_radar.studies.crosscheck import CrossCheck
    from sionna_radar.studies.radar_design import RadarDesign
    from sionna_radar.studies.sweep import Sweep
    from sionna_radar.survey.preparation import Prepared
    from sionna_radar.survey.result import Survey

DEMO = "san_francisco"


def demo(
    output: OutputOption = None,
    map_coordinates: MapOption = True,
    report: ReportOption = True,
    resume: ResumeOption = False,
    backend: BackendOption = None,
    quiet: QuietOption = False,
) -> None:
    """Simulate a survey of San Francisco, and write its results and figures."""
    log_to_stderr(quiet)
    session = Session(scenario=DEMO, output=output or Path("results/demo"), quiet=quiet, resume=resume)
    _fly(session, None, map_coordinates, report)


@command(*SCENARIO, *TEAM)
def run_command(
    session: Session,
    block_size: BlockOption = None,
    map_coordinates: MapOption = True,
    report: ReportOption = True,
    points: PointsOption = None,
    record: RecordOption = None,
    record_as: RecordAsOption = "float64",
    reference: ReferenceOption = None,
    reference_sigma: ReferenceSigmaOption = 0.0,
    apply_shift: ApplyShiftOption = False,
) -> None:
    """Simulate a scenario, and write its DEM, points, errors and figures."""
    if record and (session.workers is not None or session.scheduler is not None):
        problem = Problem("--record", "recording works in one process only; leave out --workers and --scheduler")
        raise ScenarioError([problem], "command line")
    heights = MeasuredHeights(reference, reference_sigma, apply_shift)
    _fly(session, block_size, map_coordinates, report, points, record, record_as, heights)


def _fly(
    session: Session,
    block_size: int | None,
    map_coordinates: bool,
    report: bool,
    points: list[PointsFile] | None = None,
    record: list[str] | None = None,
    record_as: str = "float64",
    heights: MeasuredHeights | None = None,
) -> None:
    checked, heights = session.load_and_precompile(), heights or MeasuredHeights()

    from sionna_radar.execution.execution import BLOCK_SIZE, Execution
    from sionna_radar.report.drawing import Coordinates
    from sionna_radar.report.survey.summary import print_survey
    from sionna_radar.scenario.loading import identity
    from sionna_radar.survey.chain import run
    from sionna_radar.survey.preparation import prepare

    coordinates = Coordinates.MAP if map_coordinates else Coordinates.LOCAL
    files, page = points or POINTS_FILES, Report.PAGE if report else Report.NONE
    if PointsFile.PARQUET in files:
        from sionna_radar.report.files.points_table import check_parquet

        check_parquet()

    def write(survey: "Survey", folder: Path) -> list[Path]:
        # Imported late: plotting libraries are slow to load, and the summary is printed first.
        from sionna_radar.report.survey.products import write_survey

        with progress_shown(session.quiet):
            return write_survey(survey, folder, coordinates, report=page, points=files, recordings=inside)

    def fly(keep: "OpenCheckpoints") -> "Survey":
        files, size = outside | inside, block_size or BLOCK_SIZE
        survey: Scenario | Prepared = checked
        if heights.path is not None:
            # A reference that does not fit is refused before a long flight.
            survey = prepare(checked)
            heights.check(survey.mapper.grid)
        if files:
            execution = Execution(block_size=size)
            return heights.beside(run(survey, recordings=files, sample_type=sample_type, execution=execution))
        with session.team() as team:
            execution = Execution(block_size=size, workers=team, checkpoints=keep(identity(checked, size)))
            return heights.beside(run(survey, execution=execution))

    outside, kinds = parse_records(record)
    sample_type = parse_sample_type(record_as, [*outside, *kinds])
    with with_the_results(kinds, session.directory("")) as inside:
        session.produce(
            fly,
            suffix="",
            marker=MARKER,
            write=write,
            show=print_survey,
            products=[coordinates, page.name, *files, *heights.products],
        )
    if checked.radar.scan.mode == "side_looking" and not session.quiet:
        typer.echo(f"this radar looks to the side: `sionna-radar image {session.scenario}` makes its image")


@command(*SCENARIO, *TEAM)
def crosscheck(
    session: Session,
) -> None:
    """Simulate the same pulses with both engines and test whether they agree; exit code 1 if not."""
    from sionna_radar.execution.execution import BLOCK_SIZE, Execution
    from sionna_radar.report.studies.crosscheck import MARKER, print_crosscheck, write_crosscheck
    from sionna_radar.scenario.loading import identity
    from sionna_radar.studies.crosscheck import run_crosscheck

    checked = session.load_and_precompile()

    def fly(keep: "OpenCheckpoints") -> "CrossCheck":
        with session.team() as team:
            checkpoints = keep(identity(checked, BLOCK_SIZE))
            return run_crosscheck(checked, execution=Execution(workers=team, checkpoints=checkpoints))

    session.produce(
        fly,
        suffix="_crosscheck",
        marker=MARKER,
        write=write_crosscheck,
        show=print_crosscheck,
        exit_code=lambda result: 0 if result.agrees else 1,
    )


@command(*SCENARIO, *TEAM)
def budget(
    session: Session,
    repeat: Annotated[int, typer.Option(min=1, help="Draws of the random errors.")] = 5,
    grades: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Custom grades of GPS/IMU: TOML tables of platform.navigation keys."),
    ] = None,
    limit: Annotated[
        str | None,
        typer.Option(metavar="rms=M", help="Largest RMS of the DEM, m, in place of the growth by 10 %: rms=0.15."),
    ] = None,
) -> None:
    """Find the GPS/IMU accuracy a survey needs: the size of each error that alone raises the RMS of the DEM by 10 %."""
    from sionna_radar.execution.execution import Execution
    from sionna_radar.report.studies.budget import MARKER, print_budget, write_budget
    from sionna_radar.studies.budget import GRADES, GROWTH, identity_of, load_grades, run_budget

    limit_m = None if limit is None else _rms_limit(limit)
    checked = session.load_and_precompile()
    known = GRADES | load_grades(grades) if grades else GRADES

    asked = identity_of(checked, GROWTH, repeat, known) | ({} if limit_m is None else {"limit": limit_m})

    def fly(keep: "OpenCheckpoints") -> "Budget":
        with session.team() as team:
            execution = Execution(workers=team, checkpoints=keep(asked))
            return run_budget(checked, limit_m=limit_m, repeat=repeat, grades=known, execution=execution)

    session.produce(fly, suffix="_budget", marker=MARKER, write=write_budget, show=print_budget)


def _rms_limit(text: str) -> float:
    """Return the limit of `rms=M`; raises ScenarioError for anything else."""
    name, _, value = text.partition("=")
    try:
        limit_m = float(value)
    except ValueError:
        limit_m = 0.0
    if name.strip() != "rms" or not 0 < limit_m < float("inf"):
        problem = Problem("--limit", f"{text!r} is no limit; give rms=M with the largest RMS error in m, e.g. rms=0.15")
        raise ScenarioError([problem], "command line")
    return limit_m


@command(*SCENARIO, *TEAM)
def sweep(
    session: Session,
    vary: Annotated[
        list[str] | None,
        typer.Option(
            "--vary",
            metavar="KEY=V1,V2,...|LOW:HIGH[:log]",
            help="Values of a dotted key, or a range of it for --sample; repeat for all combinations.",
            autocompletion=complete_key,
        ),
    ] = None,
    sample: Annotated[
        str | None,
        typer.Option("--sample", metavar="sobol|lhs:N", help="Sampling method of the ranges, and number of samples."),
    ] = None,
    table: Annotated[
        Path | None,
        typer.Option("--table", metavar="FILE", help="Settings as CSV: keys in the first line, one setting per line."),
    ] = None,
    repeat: Annotated[int, typer.Option(min=1, metavar="N", help="Seeds for each setting.")] = 1,
    runs: Annotated[
        list[RunsFile] | None,
        typer.Option("--runs", help="Write one row per survey to runs.csv, runs.parquet or both (repeat)."),
    ] = None,
    shard: Annotated[
        str | None,
        typer.Option("--shard", metavar="I/N", help="Simulate the I-th of N equal shards, to be combined by `merge`."),
    ] = None,
    sort: Annotated[
        str | None,
        typer.Option(
            "--sort", metavar="EXPR", help="Order of the table, least first; what seeds cannot tell apart is marked."
        ),
    ] = None,
    require: Annotated[
        list[str] | None,
        typer.Option("--require", metavar="CONDITION", help="Mark what meets it, e.g. 'rms_m < 0.10' (repeat)."),
    ] = None,
    pareto: Annotated[
        list[str] | None,
        typer.Option("--pareto", metavar="EXPR", help="Mark the Pareto front of expressions, each minimised (repeat)."),
    ] = None,
    keep: Annotated[
        Keep,
        typer.Option("--keep", help="Write maps."),
    ] = Keep.NONE,
) -> None:
    """Simulate a scenario with varied, listed, sampled or tabulated values; tabulate and plot its DEM errors."""
    from sionna_radar.execution.execution import Execution
    from sionna_radar.report.files.points_table import check_parquet
    from sionna_radar.report.studies.sweep import MARKER, print_sweep, write_sweep
    from sionna_radar.studies.comparison import Ranking
    from sionna_radar.studies.design import parse_design
    from sionna_radar.studies.sweep import Shard, plan_sweep, run_sweep

    design, part = parse_design(vary or [], sample, table), Shard.parse(shard) if shard else None
    files, ranking = runs or RUNS_FILES, Ranking.parse(sort, require or [], pareto or [])
    if RunsFile.PARQUET in files:
        check_parquet("runs.parquet")

    def fly(checkpoints: "OpenCheckpoints") -> "Sweep":
        with session.team() as team:
            plan = plan_sweep(session.scenario, design, repeat, session.overrides)
            execution = Execution(workers=team, checkpoints=checkpoints({**plan.identity(), "shard": str(part or "")}))
            return run_sweep(plan, shard=part, keep_maps=keep is not Keep.NONE, execution=execution)

    session.produce(
        fly,
        suffix=f"_sweep_{part.number}_of_{part.count}" if part else "_sweep",
        marker=MARKER,
        write=partial(write_sweep, runs=files, ranking=ranking, keep=keep),
        show=partial(print_sweep, ranking=ranking),
        exit_code=_tell_failures,
        products=[*files, *([sort] if sort else []), *(require or []), *(pareto or []), f"maps: {keep}"],
    )


@command(*SCENARIO, *TEAM)
def design(
    session: Session,
    free: Annotated[
        list[str] | None,
        typer.Option(
            "--free",
            metavar="KEY=LOW:HIGH[:log]|V1,V2,...",
            help="Free parameter: range or values of a dotted key (repeat), e.g. dem.method=linear,smooth.",
            autocompletion=complete_key,
        ),
    ] = None,
    minimise: Annotated[
        list[str] | None,
        typer.Option("--minimise", metavar="EXPR", help="What shall be least; twice for a Pareto front."),
    ] = None,
    maximise: Annotated[
        list[str] | None, typer.Option("--maximise", metavar="EXPR", help="What shall be greatest.")
    ] = None,
    require: Annotated[
        list[str] | None,
        typer.Option("--require", metavar="CONDITION", help="What must hold, e.g. 'rms_m < 0.10' (repeat)."),
    ] = None,
    worst_of: Annotated[
        list[str] | None,
        typer.Option(
            "--worst-of",
            metavar="SCENARIO|KEY=VALUE[;...]",
            help="Fly each setting there, too, and take the worst of all (repeat), e.g. weather.rain_rate_mm_per_h=10.",
        ),
    ] = None,
    costs: Annotated[
        Path | None,
        typer.Option("--costs", metavar="FILE", help="Costs by component, TOML or CSV, as quantities, e.g. mass_kg."),
    ] = None,
    area: Annotated[
        str | None,
        typer.Option("--area", metavar="EASTxNORTH", help="Area of flying_time_s and lines, m; default the flight's."),
    ] = None,
    overlap: Annotated[float, typer.Option(help="Overlap of neighbouring swaths over it, as a share.")] = 0.2,
    surveys: Annotated[int, typer.Option(metavar="N", help="Number of surveys in all.")] = 60,
    repeat: Annotated[int, typer.Option(min=2, metavar="N", help="Seeds with which the optimum is checked.")] = 5,
    confidence: Annotated[float, typer.Option(help="Probability with which each requirement must hold.")] = 0.9,
) -> None:
    """Find the radar and flight that meet requirements at the least cost, and how sure that is; exit code 1 if none.

    EXPR and CONDITION are arithmetic over keys of the scenario, costs, results of a survey (rms_m, le90_m, nmad_m,
    std_m, mean_m, min_m, max_m, coverage, which is the share of lit cells with a height, mapped_m2, mapped_swath_m,
    coverage_of_swath, which is that share of the planned swath, off_wall_rms_m, all_cells_rms_m, stated_sigma_m) and
    quantities in closed form: aperture_m, swath_m, area_per_hour_km2, lines, flying_time_s, line_gap_m, dwell_s,
    pulses_per_s, samples_per_s, data_rate_mbps, transmit_power_w.
    """
    from sionna_radar.execution.execution import Execution
    from sionna_radar.report.studies.flights import parse_pair
    from sionna_radar.report.studies.radar_design import MARKER, print_design, write_design
    from sionna_radar.studies.design_search import run_design
    from sionna_radar.studies.quantities import Area, read_costs
    from sionna_radar.studies.radar_design import plan_design

    size = None if area is None else parse_pair("--area", area, "x", "EASTxNORTH, e.g. 200x150")

    def fly(keep: "OpenCheckpoints") -> "RadarDesign":
        with session.team() as team:
            plan = plan_design(
                session.scenario,
                free or [],
                minimise=minimise or [],
                maximise=maximise or [],
                require=require or [],
                overrides=session.overrides,
                worst_of=worst_of or [],
                costs=None if costs is None else read_costs(costs),
                area=None if size is None else Area(size_m=size, overlap=overlap),
                surveys=surveys,
                repeat=repeat,
                confidence=confidence,
            )
            return run_design(plan, execution=Execution(workers=team, checkpoints=keep(plan.identity())))

    session.produce(
        fly,
        suffix="_design",
        marker=MARKER,
        write=write_design,
        show=print_design,
        exit_code=lambda result: 0 if result.holds else 1,
    )


def merge(
    folders: Annotated[list[Path], typer.Argument(metavar="DIR...", help="Folders of all shards.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Output folder of the merged study.")],
    quiet: QuietOption = False,
) -> None:
    """Merge the shards of a sweep into the files of an undivided one."""
    from sionna_radar.report.studies.sweep import MARKER, print_sweep, read_sweep, write_sweep
    from sionna_radar.studies.sweep import merge_shards

    log_to_stderr(quiet)
    Session(scenario="merge", output=output, quiet=quiet).produce(
        lambda *_: merge_shards([read_sweep(folder) for folder in folders]),
        suffix="",
        marker=MARKER,
        write=write_sweep,
        show=print_sweep,
        exit_code=_tell_failures,
    )


def _tell_failures(result: "Sweep") -> int:
    """Print the number of failed settings, and return the exit code: 1 if any failed."""
    if result.failed:
        failed = sum(bool(case.reason) for case in result.cases)
        typer.echo(f"{failed} of {len(result.cases)} settings failed", err=True)
    return 1 if result.failed else 0


@command(*SCENARIO)
def link(
    session: Session,
    incidence: Annotated[
        str | None,
        typer.Option("--incidence", metavar="A1,A2,...", help="Incidence angles, degrees."),
    ] = None,
    rain: Annotated[str | None, typer.Option("--rain", metavar="R1,R2,...", help="Rain rates in mm/h.")] = None,
    pulses: Annotated[int, typer.Option(min=100, max=1_000_000, help="Pulses simulated at each range.")] = 3000,
) -> None:
    """Compute the link budget over each material, in closed form and simulated; exit code 1 if they differ."""
    from sionna_radar.report.studies.link import MARKER, print_link, write_link
    from sionna_radar.studies.link import INCIDENCES_DEG, RAINS_MM_PER_H, run_link_budget

    angles, rates = _numbers("--incidence", incidence, INCIDENCES_DEG), _numbers("--rain", rain, RAINS_MM_PER_H)
    checked = session.load()
    session.produce(
        lambda _: run_link_budget(checked, incidences_deg=angles, rains_mm_per_h=rates, pulses=pulses),
        suffix="_link",
        marker=MARKER,
        write=write_link,
        show=print_link,
        exit_code=lambda result: 0 if result.agrees else 1,
    )


def _numbers(option: str, text: str | None, default: Sequence[float]) -> list[float]:
    """Return the numbers of an option, separated by commas."""
    if text is None:
        return list(default)
    try:
        return [float(part) for part in text.split(",")]
    except ValueError as error:
        message = f"{text!r} are not numbers; give some, separated by commas"
        raise ScenarioError.of(option, message, "command line") from error


@command(*SCENARIO)
def image(
    session: Session,
    ground_height: Annotated[
        float | None,
        typer.Option(
            "--ground-height",
            metavar="M",
            help="Of a recording: height of the ground on its map, m; default: that of the simulated flight.",
        ),
    ] = None,
) -> None:
    """Write the slant-range image of a side-looking scenario and, with persistent speckle, the focused one.

    In place of the scenario a recording may be given, as for `process`: its pulses are imaged along their measured
    poses.
    """
    from sionna_radar.report.studies.imagery import MARKER, print_image, write_imagery
    from sionna_radar.studies.images import Imagery, image_recording, run_images
    from sionna_radar.survey.recordings.described import is_recording

    def imaged() -> Imagery:
        if is_recording(Path(session.scenario)):
            return image_recording(session.scenario, session.overrides, ground_m=ground_height)
        if ground_height is not None:
            raise ScenarioError.of("--ground-height", "is of a recording; a scenario has its terrain", "command line")
        return run_images(session.load())

    session.produce(
        lambda _: imaged(),
        suffix="_image",
        marker=MARKER,
        write=write_imagery,
        show=print_image,
    )


@command(*SCENARIO)
def range_doppler(
    session: Session,
    chirps: Annotated[int, typer.Option(min=20, max=65536, help="Chirps of a frame.")] = 64,
    frames: Annotated[int, typer.Option(min=1, max=10_000, help="Number of consecutive frames.")] = 8,
) -> None:
    """Write range-Doppler maps of frames of chirps from the middle of the flight, with their detections."""
    from sionna_radar.report.studies.range_doppler import MARKER, print_frames, write_frames
    from sionna_radar.studies.frames import run_frames

    checked = session.load()
    session.produce(
        lambda _: run_frames(checked, chirps=chirps, frames=frames),
        suffix="_range_doppler",
        marker=MARKER,
        write=write_frames,
        show=print_frames,
    )
