"""The folder of a log's inspection."""

from functools import partial
from pathlib import Path

from sionna_radar.report.figure_files import save_figures
from sionna_radar.report.folder import write_study
from sionna_radar.report.log.figures import draw_log
from sionna_radar.report.log.table import log_summary
from sionna_radar.studies.log_inspection import LogInspection

MARKER = "log.json"


def write_log(found: LogInspection, directory: Path) -> list[Path]:
    """Write `log.json` and the figure into a directory, all or nothing, and return the files.

    Raises
    ------
    OutputError
        The directory holds something else, or cannot be written; see `write_folder`.

    """
    return write_study(directory, MARKER, log_summary(found), partial(save_figures, found, {"flight": draw_log}))
