"""The table of a sweep, for a terminal."""

from rich.table import Table

from sionna_radar.report.sweep.runs_table import setting_text
from sionna_radar.report.terminal import NONE, console, number
from sionna_radar.studies.sweep_plan import label, short
from sionna_radar.studies.sweep_result import STATISTICS, Case, Sweep

HEADINGS = {
    "rms_m": "RMS",
    "mean_m": "mean",
    "std_m": "std",
    "nmad_m": "NMAD",
    "min_m": "min",
    "max_m": "max",
    "coverage": "coverage",
    "off_wall_rms_m": "RMS off walls",
    "all_cells_rms_m": "RMS all cells",
}
# Settings that a terminal shows; the files have all of them.
MOST_ROWS = 60
SIGNED = ("min_m", "max_m", "mean_m")


def print_sweep(result: Sweep) -> None:
    """Print a sweep as a table: one row per case, mean and spread of each statistic; then the warnings."""
    out = console()
    table = sweep_table(result, "+-" if out.options.ascii_only else "±")
    # A table cut to a narrow terminal, or to the 80 columns of a pipe, would lose its numbers.
    needed = console(width=1000).measure(table).maximum
    console(width=max(out.width, needed)).print(table)
    more = len(result.cases) - MOST_ROWS
    if more > 0:
        out.print(f"and {more:,} more settings in table.csv")
    for case in result.cases[:MOST_ROWS]:
        for note in ([case.reason] if case.reason else []) + _warnings(case):
            out.print(f"{label(case.setting)}: {note}", soft_wrap=True)


def sweep_table(result: Sweep, sign: str = "±") -> Table:
    """Return one row per case: mean and spread of each statistic, with a sign between them."""
    trials = (
        f"mean of {result.repeat} trials {sign} their standard deviation" if result.repeat > 1 else "one trial each"
    )
    title = f"{result.source}: elevation error of lit cells in metres, {trials}"
    table = Table(title=title, title_justify="left")
    for axis in result.axes:
        table.add_column(axis.key, justify="right", overflow="fold")
    columns = [s for s in STATISTICS if s != "off_wall_rms_m" or any(c.mean(s) == c.mean(s) for c in result.cases)]
    for statistic in columns:
        table.add_column(HEADINGS[statistic], justify="right")
    for case in result.cases[:MOST_ROWS]:
        setting = (short(setting_text(case.setting, axis.key)) for axis in result.axes)
        table.add_row(*setting, *(_with_spread(case, s, sign) for s in columns))
    return table


def _warnings(case: Case) -> list[str]:
    """Return the warnings of a case; if the seeds differ in the numbers of one, that of the first seed."""
    return list(next((t.warnings for t in case.trials if t.warnings), ()))


def _with_spread(case: Case, statistic: str, sign: str) -> str:
    mean, spread = case.mean(statistic), case.spread(statistic)
    form = ".1%" if statistic == "coverage" else "+.3f" if statistic in SIGNED else ".3f"
    if mean != mean:
        return NONE
    return number(mean, form) + ("" if spread != spread else f" {sign}{number(spread, form.strip('+'))}")
