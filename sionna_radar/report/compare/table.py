"""The tables of a comparison, for the terminal and for its page."""

from itertools import islice
from typing import Any

from rich.table import Table

from sionna_radar.foundation.input_file import shown
from sionna_radar.report.terminal import console
from sionna_radar.studies.comparison import Comparison

MOST_KEYS = 200
ERRORS = {
    "RMS": ("rms_m", ".3f"),
    "mean": ("mean_m", "+.3f"),
    "std": ("std_m", ".3f"),
    "NMAD": ("nmad_m", ".3f"),
    "LE90": ("le90_m", ".3f"),
    "cells": ("count", ",.0f"),
    "coverage": ("coverage", ".1%"),
}


def error_rows(result: Comparison) -> dict[str, list[str]]:
    """Return the errors of lit cells by name of the folder."""
    return {
        one.name: [figure(one.summary["lit_error"][key], form) for key, form in ERRORS.values()]
        for one in result.results
    }


def setting_rows(result: Comparison) -> dict[str, list[str]]:
    """Return the settings that differ by dotted key, one value for each folder; the first `MOST_KEYS` of many."""
    rows = {
        _value(key): [_value(value) for value in values] for key, values in islice(result.differing.items(), MOST_KEYS)
    }
    more = len(result.differing) - len(rows)
    return {**rows, **({f"and {more:,} more": [""] * len(result.results)} if more else {})}


def figure(value: float | int | None, form: str) -> str:
    """Return a number in a format; a dash for one that does not exist."""
    return "-" if value is None else f"{value:{form}}"


def _value(value: Any) -> str:
    return value if isinstance(value, str) and len(value) < 60 else shown(value)


def print_comparison(result: Comparison) -> None:
    """Print the errors of lit cells, and the settings that differ."""
    errors = Table(title="DEM minus truth of lit cells, m", title_justify="left")
    errors.add_column("folder", overflow="fold")
    for name in ERRORS:
        errors.add_column(name, justify="right")
    for name, row in error_rows(result).items():
        errors.add_row(name, *row)
    console().print(errors)
    if not result.differing:
        console().print("no setting differs")
        return
    settings = Table(title="Settings that differ", title_justify="left")
    settings.add_column("key", overflow="fold")
    for one in result.results:
        settings.add_column(one.name, overflow="fold")
    for key, row in setting_rows(result).items():
        settings.add_row(key, *row)
    console().print(settings)
