"""Expressions over named values, and requirements of them.

An expression is arithmetic (`+ - * / **`, parentheses) with `abs`, `exp`, `log`, `log10`, `max`, `min`, `sqrt` over
numbers and names such as `rms_m` or `radar.antenna.beamwidth_deg`. It is parsed, never executed as Python: whatever is
not listed here is refused.
"""

import ast
import operator
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations, product
from typing import Any

import numpy as np
from jaxtyping import Float

from sionna_radar.foundation.input_file import shown
from sionna_radar.scenario.problems import nearest
from sionna_radar.scenario.reference import dotted_keys
from sionna_radar.studies.sweep.settings import refuse

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
# Option of the conditions.
REQUIRE = "--require"
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
        """Return the margin of the condition, positive if it holds; NaN where it is undefined.

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


def parse_requirement(text: str) -> Requirement:
    """Return a condition such as `rms_m < 0.10`; raises ScenarioError for anything else."""
    tree = _parsed(text, REQUIRE)
    if not isinstance(tree, ast.Compare) or len(tree.ops) != 1 or type(tree.ops[0]) not in COMPARED:
        refuse(f"{shown(text)} is no condition; give one such as 'rms_m < 0.10' or 'coverage > 0.9'", REQUIRE)
    sides = []
    for side in (tree.left, tree.comparators[0]):
        _check(side, text, REQUIRE)
        sides.append(Expression(text=ast.unparse(side), tree=side))
    if not (sides[0].names or sides[1].names):
        refuse(f"{shown(text)} names nothing that a design changes; give one such as 'rms_m < 0.10'", REQUIRE)
    if type(tree.ops[0]) in (ast.Gt, ast.GtE):
        sides.reverse()
    return Requirement(" ".join(text.split()), *sides)


# Bounds of results of a survey that hold whatever is flown.
BOUNDS = {
    **dict.fromkeys(("rms_m", "std_m", "nmad_m", "le90_m", "off_wall_rms_m", "all_cells_rms_m"), (0.0, np.inf)),
    **dict.fromkeys(("stated_sigma_m", "common_rms_m", "mapped_m2", "mapped_swath_m"), (0.0, np.inf)),
    **dict.fromkeys(("coverage", "coverage_of_swath", "pd_wire", "pd_obstacle"), (0.0, 1.0)),
    **dict.fromkeys(("warning_s", "false_alarms_per_km2", "false_alarms_per_minute"), (0.0, np.inf)),
}


def check_consistent(requirements: Sequence[Requirement]) -> None:
    """Raise ScenarioError, with the conditions, for requirements that no setting can meet together."""
    for count in (1, 2, len(requirements)):
        for chosen in combinations(requirements, min(count, len(requirements))):
            if not _possible(chosen):
                texts = " and ".join(shown(requirement.text) for requirement in chosen)
                if len(chosen) == 1:
                    refuse(f"{texts} can never hold; a result lies strictly within its bounds", REQUIRE)
                refuse(f"{texts} contradict each other; change or remove one", REQUIRE)


def _possible(requirements: Sequence[Requirement]) -> bool:
    """Return False if the requirements contradict each other, each side taken as one unknown, or as its number.

    Conditions x < y + c are edges of a graph; they contradict each other if it has a cycle whose sum is not positive
    (Cormen et al. 2009, "Introduction to algorithms", sec. 24.4). Bounds of results may be reached.
    """
    sides = {side.text: side for requirement in requirements for side in (requirement.left, requirement.right)}
    unknown = [text for text, side in sides.items() if side.names]
    node = {text: number for number, text in enumerate(unknown, 1)}
    offset = {text: 0.0 if side.names else float(side.value({})) for text, side in sides.items()}
    # least[x, y]: least c known of x - y <= c; node 0 is the number 0.
    least = np.full((len(unknown) + 1,) * 2, np.inf)
    strict = np.zeros(least.shape, dtype=bool)
    for text in unknown:
        low, high = BOUNDS.get(text, (-np.inf, np.inf))
        least[0, node[text]], least[node[text], 0] = -low, high
    for requirement in requirements:
        left, right = requirement.left.text, requirement.right.text
        x, y, c = node.get(left, 0), node.get(right, 0), offset[right] - offset[left]
        if c <= least[x, y]:
            least[x, y], strict[x, y] = c, True
    for k in range(len(least)):
        for x, y in product(range(len(least)), repeat=2):
            through = least[x, k] + least[k, y]
            if through < least[x, y]:
                least[x, y], strict[x, y] = through, strict[x, k] | strict[k, y]
            elif through == least[x, y]:
                strict[x, y] |= strict[x, k] | strict[k, y]
    own = np.diagonal(least)
    return not bool(((own < 0) | ((own == 0) & np.diagonal(strict))).any())


def check_names(names: Sequence[str], known: Sequence[str], option: str) -> None:
    """Raise ScenarioError, with the nearest name, for a name that is neither known nor a key of a scenario."""
    others = [name for name in names if name not in known]
    keys = dotted_keys() if others else []  # a third of a second
    for name in others:
        if name not in keys:
            message = f"{name} is no key of a scenario and no named quantity.{nearest(name, [*known, *keys])}"
            refuse(f"{message} `sionna-radar design --help` lists them; --costs adds yours, as mass_kg", option)


def _parsed(text: str, option: str) -> ast.expr:
    if len(text) > LONGEST:
        refuse(f"{len(text):,} characters are more than {LONGEST}; shorten the expression", option)
    try:
        return ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        refuse(f"{shown(text)} is no expression ({getattr(error, 'msg', error)}); write as in 'rms_m < 0.10'", option)


def _check(node: ast.expr, text: str, option: str) -> None:
    """Refuse all but the arithmetic of this module."""
    match node:
        case ast.BinOp(left=left, op=op, right=right) if type(op) in BINARY:
            _check(left, text, option)
            _check(right, text, option)
        case ast.UnaryOp(op=ast.USub() | ast.UAdd(), operand=inner):
            _check(inner, text, option)
        case ast.Constant(value=bool()):
            refuse(f"{shown(text)}: {ast.unparse(node)} is no number", option)
        case ast.Constant(value=int() | float() as number):
            if not abs(number) <= sys.float_info.max:
                refuse(f"{shown(text)}: {shown(ast.unparse(node))} is too large; give at most 1e308", option)
        case ast.Name():
            return
        case ast.Attribute() if _dotted(node) is not None:
            return
        case ast.Call(func=ast.Name(id=name), args=[_, *_] as args, keywords=[]) if name in FUNCTIONS:
            if name not in ("max", "min") and len(args) != 1:
                refuse(f"{shown(text)}: {name} takes one value", option)
            for inner in args:
                _check(inner, text, option)
        case _:
            allowed = f"numbers, names, + - * / ** and {', '.join(FUNCTIONS)}"
            refuse(f"{shown(text)}: {shown(ast.unparse(node))} is not allowed; use {allowed}", option)


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
