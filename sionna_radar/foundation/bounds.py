"""Bounds checks of command-line options and function arguments."""

from collections.abc import Iterable

from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.input_file import shown


def check_bounds(rows: Iterable[tuple[str, float | None, float, float]], source: str = "command line") -> None:
    """Raise ScenarioError, with all problems, unless values lie within their bounds.

    rows: name, value (None: not given), least and greatest value. Neither infinities nor NaN lie within bounds.
    """
    problems = [
        Problem(name, f"{_written(value)} must be at least {least:g} and at most {most:g}")
        for name, value, least, most in rows
        if value is not None and not least <= value <= most
    ]
    if problems:
        raise ScenarioError(problems, source)


def _written(value: float) -> str:
    """Return a number as shown in errors, also a whole one that no float holds."""
    return shown(value) if isinstance(value, int) else f"{value:g}"
