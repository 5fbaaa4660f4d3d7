"""The formats in which the points of a survey are written; light, as the command line lists them."""

from enum import StrEnum


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
