"""Terminal output: tables and text without markup, in any encoding, and progress reports.

Descriptions, names and paths come from the user, and may contain text that a terminal library interprets as markup or
an encoding cannot represent.
"""

import codecs
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from time import monotonic
from typing import TYPE_CHECKING

from sionna_radar.foundation.interrupts import raise_received
from sionna_radar.foundation.progress import Progress as Report
from sionna_radar.foundation.progress_bars import RemainingTime, progress_bar

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from sionna_radar.accuracy.reference_check import ReferenceCheck

# Shown for an undefined number.
NONE = "-"
PLAIN = {"±": "+-", "→": "->", "–": "-", "…": "...", "²": "2", "°": " deg", "µ": "u", "×": "x"}
SECONDS_BETWEEN_LINES = 10.0


def console(width: int | None = None) -> "Console":
    """Return a console that prints text literally."""
    # Slow to import, and not needed by all commands.
    from rich.console import Console

    return Console(markup=False, emoji=False, highlight=False, width=width)


def say(*texts: str) -> None:
    """Print texts, each on a line of its own, however long."""
    for text in texts:
        console().print(text, soft_wrap=True)


def table_of(
    title: str, columns: Sequence[str], rows: Iterable[Iterable[str]], *, left: Collection[str] = ()
) -> "Table":
    """Return a table with a heading; columns of numbers are flush right, those of text, `left`, flush left."""
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for name in columns:
        table.add_column(name, justify="left" if name in left else "right", overflow="fold")
    # Characters that are spelled out later, when they are printed, would be wider than their column.
    wider = str.maketrans(PLAIN) if console().options.ascii_only else {}
    for row in rows:
        table.add_row(*(text.translate(wider) for text in row))
    return table


def table_of_values(title: str | None, values: Mapping[str, str]) -> "Table":
    """Return a table of names and values without a heading."""
    from rich.table import Table

    table = Table(title=title, title_justify="left", show_header=False)
    for row in values.items():
        table.add_row(*row)
    return table


def print_whole(table: "Table") -> None:
    """Print a table at its own width, also to a narrow terminal or a pipe: truncated numbers say nothing."""
    console(width=max(console().width, console(width=1000).measure(table).maximum)).print(table)


def printable(text: object) -> str:
    """Return a text with control characters escaped, such as those in names and paths."""
    return "".join(c if c.isprintable() or c in "\n\t" else ascii(c)[1:-1] for c in str(text))


def number(value: float | int, form: str, unit: str = "") -> str:
    """Return a formatted number with its unit; a dash for NaN."""
    return NONE if value != value else f"{value:{form}}{unit}"


def with_spread(mean: float, spread: float, form: str) -> str:
    """Return a mean and its spread, such as a standard deviation; without one if it is NaN, a dash for no mean."""
    if mean != mean or spread != spread:
        return number(mean, form)
    return f"{number(mean, form)} ± {number(spread, form.lstrip('+'))}"


def print_on_any_encoding() -> None:
    """Replace characters that standard output and error cannot encode, instead of failing."""
    codecs.register_error("sionna_radar.plain", _spelled_out)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="sionna_radar.plain")


def _spelled_out(error: UnicodeError) -> tuple[str | bytes, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    unknown = error.object[error.start : error.end]
    return "".join(PLAIN.get(letter, ascii(letter)[1:-1]) for letter in unknown), error.end


@contextmanager
def shown_progress() -> Iterator[Report]:
    """Yield a progress callback: on standard error, a bar per stage on a terminal, else lines."""
    from rich.console import Console

    screen = Console(stderr=True, markup=False)
    if not screen.is_terminal:
        yield lines(lambda text: print(text, file=sys.stderr, flush=True), monotonic)
        return
    with progress_bar(screen) as report:
        yield report


def lines(write: Callable[[str], None], clock: Callable[[], float]) -> Report:
    """Return a progress callback that writes a line at most every ten seconds."""
    last, left = clock(), RemainingTime()

    def report(stage: str, done: int, total: int) -> None:
        """Write a line if the last one is old enough."""
        nonlocal last
        raise_received()
        now = clock()
        until_end = left.text(stage, done, total, now)
        if now - last >= SECONDS_BETWEEN_LINES:
            last = now
            write(", ".join(filter(None, [f"{stage}: {done:,} of {total:,}" if total else stage, until_end])))

    return report


def reference_rows(check: "ReferenceCheck") -> dict[str, str]:
    """Return the estimated shift of a DEM against measured heights, and its errors, by their names."""
    shift, error = check.shift, check.statistics
    horizontal = (
        "not observable: too little relief within 20 m"
        if check.error is not None
        else "not estimated from single points"
    )
    if shift.east_m is not None and shift.north_m is not None:
        east = f"{shift.east_m:+.2f} ± {shift.east_sigma_m:.2f} m east"
        horizontal = f"{east}, {shift.north_m:+.2f} ± {shift.north_sigma_m:.2f} m north"
    tilts = {"east": (shift.tilt_east, shift.tilt_east_sigma), "north": (shift.tilt_north, shift.tilt_north_sigma)}
    tilt = [
        f"{1e3 * value:+.2f} ± {1e3 * sigma:.2f} mm/m toward {way}"
        for way, (value, sigma) in tilts.items()
        if value is not None and sigma is not None
    ]
    rms, mean, spread = (
        number(value, form, " m")
        for value, form in ((error.rms_m, ".3f"), (error.mean_m, "+.3f"), (error.nmad_m, ".3f"))
    )
    accuracy = f"standard deviation {check.sigma_m:.3f} m" if check.sigma_m else "reference accuracy not stated"
    return {
        "reference": f"{check.name} ({check.kind}), {accuracy}",
        "DEM against reference": horizontal,
        "vertical shift": f"{shift.up_m:+.3f} ± {shift.up_sigma_m:.3f} m",
        "tilt": ", ".join(tilt) or "not estimated",
        "RMS without outliers": f"{shift.rms_m:.3f} m, {shift.shifted_rms_m:.3f} m after the shift",
        "RMSE against reference": f"{rms}, bias {mean}, NMAD {spread} of {error.count:,}, shift "
        + ("taken out" if check.applied else "left in"),
        "not available": "; ".join(f"error by {name} ({reason})" for name, reason in check.missing.items()) or NONE,
    }
