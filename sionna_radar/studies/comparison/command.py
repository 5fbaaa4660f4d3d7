"""Command `compare`: results side by side."""

from pathlib import Path
from typing import Annotated

import typer

from sionna_radar.cli.session import (
    ApplyShiftOption,
    Listed,
    MeasuredHeights,
    QuietOption,
    ReferenceOption,
    ReferenceSigmaOption,
    log_to_stderr,
)
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.input_file import shown


def compare(
    folders: Annotated[
        list[Path],
        typer.Argument(metavar="DIR1 DIR2 ...", help="Folders of results of `run`; or of `sweep` and `design`."),
    ],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="Folder for compare.html (default: none).")
    ] = None,
    reference: ReferenceOption = None,
    reference_sigma: ReferenceSigmaOption = 0.0,
    apply_shift: ApplyShiftOption = False,
    quiet: QuietOption = False,
) -> None:
    """Compare several results: errors, differing settings, and maps side by side, or with measured heights."""
    from sionna_radar.report.files.folder import check_output
    from sionna_radar.studies.comparison.document import (
        DOCUMENT,
        compare_folder,
        is_study,
        print_references,
        print_studies,
    )
    from sionna_radar.studies.comparison.results import compare as compare_folders

    log_to_stderr(quiet)
    if any(is_study(folder) for folder in folders):
        if output is not None or reference is not None:
            option = "--reference" if output is None else "-o"
            raise ScenarioError.of_option(option, "is for folders of `run`; leave it out for studies")
        print_studies(folders)
        return
    if output is not None and len(folders) == 1:
        raise ScenarioError.of_option("-o", "is for the page of two folders or more; leave it out for one")
    directory = check_output(output, DOCUMENT.marker) if output else None
    heights = MeasuredHeights(reference, reference_sigma, apply_shift)
    if heights.path is not None:
        checks = [compare_folder(folder, heights.path, reference_sigma, apply_shift) for folder in folders]
        if not quiet:
            print_references(folders, checks)
        if len(folders) == 1 and directory is None:
            return
    result = compare_folders(folders)
    written = DOCUMENT.write(result, directory) if directory else []
    if not quiet:
        DOCUMENT.show(result)
        if directory:
            typer.echo(f"{len(written)} files in {shown(directory)}")


COMMANDS = (Listed("Study", "compare", compare),)
