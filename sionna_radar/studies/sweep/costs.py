"""Costs of a radar by component: numbers, or expressions over keys and quantities."""

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from jaxtyping import Float

from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import parse_toml, read_text, shown
from sionna_radar.studies.sweep.expressions import Expression, Values, parse_expression


@dataclass(frozen=True)
class Costs:
    """Costs by component, such as mass_kg and price_eur: each a number, or an expression.

    components: expressions by cost, by component.
    """

    components: Mapping[str, Mapping[str, Expression]] = field(default_factory=dict)

    @staticmethod
    def of(tables: Mapping[str, Any], source: str = "costs") -> "Costs":
        """Return the costs of tables by component, each value a number or the text of an expression.

        Raises InputFileError for anything else, and ScenarioError for a wrong expression.
        """
        components: dict[str, dict[str, Expression]] = {}
        for component, table in tables.items():
            if not isinstance(table, dict) or not table:
                _no_costs(source, f"{component} is no table of costs")
            for name, value in table.items():
                if not name.isidentifier():
                    _no_costs(source, f"{shown(name)} is no name of a cost")
                if isinstance(value, bool) or not isinstance(value, int | float | str):
                    _no_costs(source, f"{component}.{name} = {shown(str(value))} is neither a number nor an expression")
                expression = parse_expression(str(value), f"{source}, {component}.{name}")
                components.setdefault(component, {})[name] = expression
        if not components:
            _no_costs(source, "there is no component")
        return Costs(components)

    @property
    def names(self) -> tuple[str, ...]:
        """The costs: their sums over the components are quantities by these names."""
        return tuple(dict.fromkeys(name for costs in self.components.values() for name in costs))

    @property
    def needs(self) -> tuple[str, ...]:
        """The names that the costs depend on."""
        found = (name for costs in self.components.values() for cost in costs.values() for name in cost.names)
        return tuple(dict.fromkeys(found))

    def totals(self, values: Values) -> dict[str, Float[np.ndarray, "..."]]:
        """Return the sum of each cost over the components."""
        return {name: np.asarray(sum(self.parts(name, values).values())) for name in self.names}

    def parts(self, name: str, values: Values) -> dict[str, Float[np.ndarray, "..."]]:
        """Return one cost by component."""
        return {part: costs[name].value(values) for part, costs in self.components.items() if name in costs}


COSTS_REMEDY = (
    "give a TOML file of [component] tables such as mass_kg = 0.3, or a CSV file whose first column names the "
    "components; a value is a number or an expression in quotes"
)


def read_costs(path: Path) -> Costs:
    """Return the costs in a TOML or CSV file; InputFileError for any other, ScenarioError for a wrong expression."""
    text = read_text(path, "--costs", COSTS_REMEDY)
    try:
        tables = _csv_tables(text) if path.suffix.lower() == ".csv" else parse_toml(text)
    except (ValueError, csv.Error) as error:
        _no_costs(f"--costs {shown(path)}", str(error))
    return Costs.of(tables, f"--costs {shown(path)}")


def _csv_tables(text: str) -> dict[str, dict[str, str]]:
    rows = list(csv.DictReader(io.StringIO(text, newline=""), strict=True))
    tables: dict[str, dict[str, str]] = {}
    for row in rows:
        if None in row or None in row.values():
            raise ValueError(f"line {len(tables) + 2} has another number of values than line 1")
        name, *values = row.values()
        if name in tables:
            raise ValueError(f"component {name} is there twice")
        keys = [key.strip() for key in row][1:]
        tables[name.strip()] = {key: value for key, value in zip(keys, values, strict=True) if value.strip()}
    return tables


def _no_costs(source: str, message: str) -> NoReturn:
    raise InputFileError(f"{source}: {message}; {COSTS_REMEDY}")
