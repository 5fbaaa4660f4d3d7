"""Bounds checks of command-line options and function arguments."""

from collections.abc import Iterable

from sionna_radar.foundation.errors import Problem, ScenarioError


def check_bounds(rows: Iterable[tuple[str, float | None, float, float]], source: str = "command line") -> None:
    """Raise ScenarioError, with all problems, unless values lie within their bounds.

    rows: name, value (None: not given), least and greatest value. Neither infinities nor NaN lie within bounds.
    """
    problems = [
        Problem(name, f"{value:g} must be at least {least:g} and at most {most:g}")
        for name, value, least, most in rows
        if value is not None and not least <= value <= most
    ]
    if problems:
        raise ScenarioError(problems, source)
