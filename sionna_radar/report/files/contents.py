"""Optional contents of a folder of results: kinds of files, and their selection."""

from enum import Enum, StrEnum

# The file that identifies such a folder.
MARKER = "summary.json"


class Report(Enum):
    """Selection of the page `report.html` in a folder of results."""

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


# CSV too, for users without a LAZ reader; it takes 4 s per million points.
POINTS_FILES = (PointsFile.LAZ, PointsFile.CSV)


class RunsFile(StrEnum):
    """Formats of the table with one row per survey."""

    CSV = "csv"
    PARQUET = "parquet"


RUNS_FILES = (RunsFile.CSV,)
