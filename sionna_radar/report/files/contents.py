"""What a folder of results may hold: kinds of files, and how each is chosen."""

from enum import Enum, StrEnum

# The file by which such a folder is known.
MARKER = "summary.json"


class Report(Enum):
    """Whether a folder of results has a page to look at, `report.html`."""

    PAGE = "page"
    NONE = "none"


class PointsFile(StrEnum):
    """Formats of the points of a survey.

    Examples
    --------
    >>> from pathlib import Path
    >>> survey = run(load_scenario("hills", {"platform.length_m": 10.0}))
    >>> files = write_survey(survey, Path("results"), points=[PointsFile.CSV])
    >>> [file.name for file in files if file.stem == "points"]
    ['points.csv']

    """

    LAZ = "laz"
    CSV = "csv"
    PARQUET = "parquet"


# CSV too: whoever has no program for LAZ opens that, and it takes 4 s for a million points.
POINTS_FILES = (PointsFile.LAZ, PointsFile.CSV)


class RunsFile(StrEnum):
    """Formats of the table with a row for each survey."""

    CSV = "csv"
    PARQUET = "parquet"


RUNS_FILES = (RunsFile.CSV,)
