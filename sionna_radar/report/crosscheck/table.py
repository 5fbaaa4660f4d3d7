"""The table of a cross-check, for the terminal."""

from rich.table import Table

from sionna_radar.report.terminal import console, number
from sionna_radar.studies.crosscheck_result import CrossCheck


def crosscheck_table(check: CrossCheck) -> Table:
    """Return each difference with its tolerance and whether it is within it."""
    table = Table(title=f"The engines {'agree' if check.agrees else 'DIFFER'}", title_justify="left")
    for name in ("difference", "value", "within", ""):
        table.add_column(name, justify="left" if name in ("difference", "") else "right")
    for name, part in check.verdict().items():
        within = number(part["tolerance"], ".4f")
        table.add_row(name, number(part["value"], "+.4f"), within, "agrees" if part["agrees"] else "DIFFERS")
    return table


def print_crosscheck(check: CrossCheck) -> None:
    """Print each difference with its tolerance, and the verdict."""
    screen = console()
    for name, part in check.verdict().items():
        word = "agrees" if part["agrees"] else "DIFFERS"
        value = number(part["value"], "+.4f")
        chance = f"   (by speckle alone: {part['probability']:.4f})" if "probability" in part else ""
        screen.print(
            f"{name:32}{value:>10}   within {number(part['tolerance'], '.4f')}   {word}{chance}", soft_wrap=True
        )
    screen.print(f"the engines {'agree' if check.agrees else 'DIFFER'}")
    screen.print(
        "shared by both, so not checked: ray casting, antenna, backscatter models, targets, mirrors", soft_wrap=True
    )
