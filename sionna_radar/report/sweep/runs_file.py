"""The formats in which the surveys of a study are tabulated; light, as the command line lists them."""

from enum import StrEnum


class RunsFile(StrEnum):
    """Formats of the table with a row for each survey."""

    CSV = "csv"
    PARQUET = "parquet"


RUNS_FILES = (RunsFile.CSV,)
