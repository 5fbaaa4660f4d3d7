"""The table of a sweep, for a terminal."""

from rich.console import Console
from rich.table import Table

from sionna_radar.sweep import STATISTICS, Case, Sweep


def print_sweep(result: Sweep) -> None:
    """Print a sweep as a table: a row a case, mean and spread of each statistic."""
    runs = f"mean of {result.repeat} runs ± their standard deviation" if result.repeat > 1 else "one run each"
    table = Table(title=f"{result.source}: elevation error in metres, {runs}", title_justify="left")
    for axis in result.axes:
        table.add_column(axis.key, justify="right", overflow="fold")
    for statistic in STATISTICS:
        table.add_column(statistic.removesuffix("_m").replace("rms", "RMS").replace("nmad", "NMAD"), justify="right")
    for case in result.cases:
        table.add_row(*map(str, case.setting.values()), *(_with_spread(case, s) for s in STATISTICS))
    # A table cut to a narrow terminal, or to the 80 columns of a pipe, would lose its numbers.
    needed = Console(width=1000).measure(table).maximum
    Console(highlight=False, width=max(Console().width, needed)).print(table)


def _with_spread(case: Case, statistic: str) -> str:
    mean, spread = case.mean(statistic), case.spread(statistic)
    if statistic == "coverage":
        return f"{mean:.1%}" if spread != spread else f"{mean:.1%} ±{spread:.1%}"
    sign = "+" if statistic in ("min_m", "max_m", "mean_m") else ""
    return f"{mean:{sign}.3f}" if spread != spread else f"{mean:{sign}.3f} ±{spread:.3f}"
