"""Commands `sweep` and `merge`: varied settings, and shards of a study."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sionna_radar.cli.session import SCENARIO, TEAM, Listed, QuietOption, Session, command, complete_key, log_to_stderr
from sionna_radar.report.files.contents import RUNS_FILES, Keep, RunsFile

if TYPE_CHECKING:
    from sionna_radar.cli.session import OpenCheckpoints
    from sionna_radar.studies.sweep.study import Sweep


@command(*SCENARIO, *TEAM)
def sweep(
    session: Session,
    vary: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=V1,V2,...|LOW:HIGH[:log]",
            help="Values of a dotted key, or a range of it for --sample; repeat for all combinations.",
            autocompletion=complete_key,
        ),
    ] = None,
    sample: Annotated[
        str | None, typer.Option(metavar="sobol|lhs:N", help="Sampling method of the ranges, and number of samples.")
    ] = None,
    table: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Settings as CSV: keys in the first line, one setting per line.")
    ] = None,
    repeat: Annotated[
        int, typer.Option(min=1, metavar="N", help="Seeds for each setting, or for the scenario as it is.")
    ] = 1,
    runs: Annotated[
        list[RunsFile] | None, typer.Option(help="Write one row per survey to runs.csv, runs.parquet or both (repeat).")
    ] = None,
    shard: Annotated[
        str | None, typer.Option(metavar="I/N", help="Simulate the I-th of N equal shards, to be combined by `merge`.")
    ] = None,
    sort: Annotated[
        str | None,
        typer.Option(metavar="EXPR", help="Order of the table, least first; what seeds cannot separate is marked."),
    ] = None,
    require: Annotated[
        list[str] | None, typer.Option(metavar="CONDITION", help="Mark what meets it, e.g. 'rms_m < 0.10' (repeat).")
    ] = None,
    pareto: Annotated[
        list[str] | None,
        typer.Option(metavar="EXPR", help="Mark the Pareto front of expressions, each minimised (repeat)."),
    ] = None,
    keep: Annotated[Keep, typer.Option(help="Write maps.")] = Keep.NONE,
) -> None:
    """Simulate a scenario with varied, listed, sampled or tabulated values, or with many seeds; tabulate its errors."""
    from sionna_radar.report.files.points_table import check_parquet
    from sionna_radar.studies.sweep.document import sweep_document
    from sionna_radar.studies.sweep.plan import Shard, plan_sweep
    from sionna_radar.studies.sweep.ranking import Ranking
    from sionna_radar.studies.sweep.settings import Design, parse_design
    from sionna_radar.studies.sweep.study import run_sweep

    varied = repeat == 1 or bool(vary or sample or table)
    design = parse_design(vary or [], sample, table) if varied else Design(seeds_alone=True)
    part = Shard.parse(shard) if shard else None
    files, ranking = runs or RUNS_FILES, Ranking.parse(sort, require or [], pareto or [])
    if RunsFile.PARQUET in files:
        check_parquet("runs.parquet")

    def fly(checkpoints: "OpenCheckpoints") -> "Sweep":
        plan = plan_sweep(session.scenario, design, repeat, session.overrides)
        with session.execution(checkpoints, {**plan.identity(), "shard": str(part or "")}) as execution:
            return run_sweep(plan, shard=part, keep_maps=keep is not Keep.NONE, execution=execution)

    document = sweep_document(files, ranking, keep)
    if part is not None:
        document = replace(document, suffix=f"_sweep_{part.number}_of_{part.count}")
    session.produce(
        fly,
        document,
        exit_code=_tell_failures,
        products=[*files, *([sort] if sort else []), *(require or []), *(pareto or []), f"maps: {keep}"],
    )


def merge(
    folders: Annotated[list[Path], typer.Argument(metavar="DIR...", help="Folders of all shards.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Output folder of the merged study.")],
    quiet: QuietOption = False,
) -> None:
    """Merge the shards of a sweep into the files of an undivided one."""
    from sionna_radar.studies.sweep.document import DOCUMENT
    from sionna_radar.studies.sweep.results import read_sweep
    from sionna_radar.studies.sweep.study import merge_shards

    log_to_stderr(quiet)
    Session(scenario="merge", output=output, quiet=quiet).produce(
        lambda *_: merge_shards([read_sweep(folder) for folder in folders]), DOCUMENT, exit_code=_tell_failures
    )


def _tell_failures(result: "Sweep") -> int:
    if result.failed:
        failed = sum(bool(case.reason) for case in result.cases)
        typer.echo(f"{failed} of {len(result.cases)} settings failed", err=True)
    return 1 if result.failed else 0


COMMANDS = (Listed("Study", "sweep", sweep), Listed("Study", "merge", merge))
