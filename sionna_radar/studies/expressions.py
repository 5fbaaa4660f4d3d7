"""Expressions over keys of a scenario, named quantities, errors and costs: requirements, objectives, tables of costs.

An expression is arithmetic (`+ - * / **`, parentheses) with `abs`, `exp`, `log`, `log10`, `max`, `min`, `sqrt` over
numbers and names such as `rms_m` or `radar.antenna.beamwidth_deg`. It is parsed, never executed as Python: whatever is
not listed here is refused.
"""

import ast
import csv
import io
import operator
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from jaxtyping import Float

from sionna_radar.foundation.errors import InputFileError, Problem, ScenarioError
from sionna_radar.foundation.input_file import parse_toml, read_text, shown
from sionna_radar.scenario.problems import nearest

LONGEST = 500
BINARY: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}
FUNCTIONS: dict[str, Callable[..., Any]] = {
    "abs": np.abs,
    "exp": np.exp,
    "log": np.log,
    "log10": np.log10,
    "max": lambda *values: np.maximum.reduce(np.broadcast_arrays(*values)),
    "min": lambda *values: np.minimum.reduce(np.broadcast_arrays(*values)),
    "sqrt": np.sqrt,
}
COMPARED = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">="}
# Values by name: numbers, or arrays of one shape.
Values = Mapping[str, Any]


@dataclass(frozen=True)
class Expression:
    """A parsed expression; equal to another one of the same text."""

    text: str
    tree: ast.expr = field(repr=False, compare=False)

    @property
    def names(self) -> tuple[str, ...]:
        """The names that it depends on, each once."""
        return tuple(dict.fromkeys(_names(self.tree)))

    def value(self, values: Values) -> Float[np.ndarray, "..."]:
        """Return its value; NaN or infinite where it is undefined, such as the logarithm of a negative number."""
        with np.errstate(all="ignore"):
            return np.asarray(_value(self.tree, values), dtype=float)


@dataclass(frozen=True)
class Requirement:
    """A condition LEFT < RIGHT; `a > b` is stored as b < a."""

    text: str
    left: Expression
    right: Expression

    @property
    def names(self) -> tuple[str, ...]:
        """The names that it depends on, each once."""
        return tuple(dict.fromkeys((*self.left.names, *self.right.names)))

    def margin(self, values: Values, relaxed: float = 0.0) -> Float[np.ndarray, "..."]:
        """Return how far the condition holds, positive if it does; NaN where it is undefined.

        relaxed: share by which the limit, a side without errors of a survey or else the right one, gives way.
        """
        left, right = self.left.value(values), self.right.value(values)
        limit = left if not self.left.names else right
        return np.asarray(right - left + relaxed * np.abs(limit))


def parse_expression(text: str, option: str) -> Expression:
    """Return an expression; raises ScenarioError, with the option or field that holds it, for anything else."""
    tree = _parsed(text, option)
    _check(tree, text, option)
    return Expression(text=" ".join(text.split()), tree=tree)


def parse_requirement(text: str, option: str = "--require") -> Requirement:
    """Return a condition such as `rms_m < 0.10`; raises ScenarioError for anything else."""
    tree = _parsed(text, option)
    if not isinstance(tree, ast.Compare) or len(tree.ops) != 1 or type(tree.ops[0]) not in COMPARED:
        _refuse(option, f"{shown(text)} is no condition; give one such as 'rms_m < 0.10' or 'coverage > 0.9'")
    sides = []
    for side in (tree.left, tree.comparators[0]):
        _check(side, text, option)
        sides.append(Expression(text=ast.unparse(side), tree=side))
    if not (sides[0].names or sides[1].names):
        _refuse(option, f"{shown(text)} names nothing that a design changes; give one such as 'rms_m < 0.10'")
    if type(tree.ops[0]) in (ast.Gt, ast.GtE):
        sides.reverse()
    return Requirement(" ".join(text.split()), *sides)


def check_names(names: Sequence[str], known: Sequence[str], option: str) -> None:
    """Raise ScenarioError, with the nearest known name, for a name that is not known."""
    for name in names:
        if name not in known:
            message = f"{name} is no key of a scenario and no named quantity.{nearest(name, list(known))}"
            _refuse(option, f"{message} `sionna-radar design --help` lists the quantities")


def _parsed(text: str, option: str) -> ast.expr:
    if len(text) > LONGEST:
        _refuse(option, f"{len(text):,} characters are more than {LONGEST}; shorten the expression")
    try:
        return ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        _refuse(option, f"{shown(text)} is no expression ({getattr(error, 'msg', error)}); write as in 'rms_m < 0.10'")


def _check(node: ast.expr, text: str, option: str) -> None:
    """Refuse all but the arithmetic of this module."""
    match node:
        case ast.BinOp(left=left, op=op, right=right) if type(op) in BINARY:
            _check(left, text, option)
            _check(right, text, option)
        case ast.UnaryOp(op=ast.USub() | ast.UAdd(), operand=inner):
            _check(inner, text, option)
        case ast.Constant(value=bool()):
            _refuse(option, f"{shown(text)}: {ast.unparse(node)} is no number")
        case ast.Constant(value=int() | float()) | ast.Name():
            return
        case ast.Attribute() if _dotted(node) is not None:
            return
        case ast.Call(func=ast.Name(id=name), args=[_, *_] as args, keywords=[]) if name in FUNCTIONS:
            if name not in ("max", "min") and len(args) != 1:
                _refuse(option, f"{shown(text)}: {name} takes one value")
            for inner in args:
                _check(inner, text, option)
        case _:
            allowed = f"numbers, names, + - * / ** and {', '.join(FUNCTIONS)}"
            _refuse(option, f"{shown(text)}: {shown(ast.unparse(node))} is not allowed; use {allowed}")


def _dotted(node: ast.expr) -> str | None:
    """Return the dotted name of a node; None if it is no name."""
    if isinstance(node, ast.Attribute):
        head = _dotted(node.value)
        return None if head is None else f"{head}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else None


def _names(node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.expr) and (name := _dotted(node)) is not None:
        yield name
    elif isinstance(node, ast.Call):
        for inner in node.args:
            yield from _names(inner)
    else:
        for child in ast.iter_child_nodes(node):
            yield from _names(child)


def _value(node: ast.expr, values: Values) -> Any:
    name = _dotted(node)
    if name is not None:
        return np.asarray(values[name], dtype=float)
    match node:
        case ast.BinOp(left=left, op=op, right=right):
            return BINARY[type(op)](_value(left, values), _value(right, values))
        case ast.UnaryOp(op=op, operand=inner):
            return -_value(inner, values) if isinstance(op, ast.USub) else _value(inner, values)
        case ast.Call(func=ast.Name(id=function), args=args):
            return FUNCTIONS[function](*(_value(inner, values) for inner in args))
        case ast.Constant(value=int() | float() as number):
            return np.float64(number)
    raise AssertionError(node)  # checked when it was parsed


@dataclass(frozen=True)
class Costs:
    """Costs by component, such as mass_kg and price_eur: each a number, or an expression.

    components: expressions by cost, by component.
    """

    components: Mapping[str, Mapping[str, Expression]] = field(default_factory=dict)

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
    """Return the costs in a TOML or CSV file.

    Raises
    ------
    InputFileError
        It cannot be read, or is no such table.
    ScenarioError
        An expression is wrong.

    """
    text = read_text(path, "--costs", COSTS_REMEDY)
    try:
        tables = _csv_tables(text) if path.suffix.lower() == ".csv" else parse_toml(text)
    except (ValueError, csv.Error) as error:
        _no_costs(path, str(error))
    components: dict[str, dict[str, Expression]] = {}
    for component, table in tables.items():
        if not isinstance(table, dict) or not table:
            _no_costs(path, f"{component} is no table of costs")
        for name, value in table.items():
            if not name.isidentifier():
                _no_costs(path, f"{shown(name)} is no name of a cost")
            if isinstance(value, bool) or not isinstance(value, int | float | str):
                _no_costs(path, f"{component}.{name} = {shown(str(value))} is neither a number nor an expression")
            where = f"--costs {shown(path)}, {component}.{name}"
            components.setdefault(component, {})[name] = parse_expression(str(value), where)
    if not components:
        _no_costs(path, "it has no component")
    return Costs(components)


def _csv_tables(text: str) -> dict[str, dict[str, str]]:
    rows = list(csv.DictReader(io.StringIO(text, newline=""), strict=True))
    tables: dict[str, dict[str, str]] = {}
    for row in rows:
        if None in row or None in row.values():
            message = f"line {len(tables) + 2} has another number of values than line 1"
            raise ValueError(message)
        name, *values = row.values()
        if name in tables:
            message = f"component {name} is there twice"
            raise ValueError(message)
        keys = [key.strip() for key in row][1:]
        tables[name.strip()] = {key: value for key, value in zip(keys, values, strict=True) if value.strip()}
    return tables


def _no_costs(path: Path, message: str) -> NoReturn:
    text = f"--costs {shown(path)}: {message}; {COSTS_REMEDY}"
    raise InputFileError(text)


def _refuse(option: str, message: str) -> NoReturn:
    raise ScenarioError([Problem(option, message)], "command line")
