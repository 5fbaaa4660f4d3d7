"""Base class of all scenario tables: frozen pydantic models, strict numbers with bounds, errors with a key, units.

The meaning of a key is its field's description, or the string under it (`reference.meanings`); pydantic would read
the source of each table to find it whenever the package is imported, which takes 0.1 s. The unit of a key is the end
of its name.
"""

import inspect
import re
from collections.abc import Collection, Iterator
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, get_args, get_origin

import numpy as np
import tomli_w
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.input_file import compact, is_address, shown
from sionna_radar.scenario.problems import translate, unknown

Made = TypeVar("Made")
# Bounds of all numbers: far beyond plausible values, and small enough that products and powers do not overflow.
LARGEST, SMALLEST = 1e15, 1e-15
LONGEST_PATH = 4096


# Keys that contradict others, with the reason and the remedy.
Conflicts = Iterator[tuple[str, str]]


def refuse(field: str, message: str) -> PydanticCustomError:
    """Return the error of a check, for a dotted key."""
    return PydanticCustomError("scenario", "{message}", {"message": message, "field": field})


def _not_vanishing(value: float) -> float:
    if value < SMALLEST:
        raise refuse("", f"must be at least {compact(SMALLEST)}, not {compact(value)}")
    return value


def one_of(known: Collection[str]) -> AfterValidator:
    """Return the check that a name is one of some known ones."""

    def check(name: str) -> str:
        if name not in known:
            raise refuse("", unknown(name, list(known)))
        return name

    return AfterValidator(check)


def _a_source(source: Any) -> Any:
    """Keep an address as text: a path would lose a slash."""
    return Path(source) if isinstance(source, str) and not is_address(source) else source


def _a_path(path: Path) -> Path:
    text = str(path)
    if "\0" in text or len(text) > LONGEST_PATH or any("\ud800" <= c <= "\udfff" for c in text):
        raise refuse("", f"{shown(path)} is not a path: it is too long, or holds characters that no path can")
    return path


Real = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-LARGEST, le=LARGEST)]
NonNegative = Annotated[Real, Field(ge=0)]
# Zero, or not too small to compute with.
NoneOrSome = Annotated[Real, Field(ge=0), AfterValidator(lambda value: value and _not_vanishing(value))]
Positive = Annotated[Real, Field(gt=0), AfterValidator(_not_vanishing)]
Seed = Annotated[int, Field(strict=True, ge=0, lt=2**63)]
Point2 = tuple[Real, Real]
Point3 = tuple[Real, Real, Real]
# Corners of a line or an outline in a scenario; longer ones are read from files.
MAX_CORNERS = 10_000


def _enclosing(corner_m: tuple[Point2, ...]) -> tuple[Point2, ...]:
    """Refuse an outline that encloses no area, or two of whose edges cross: its corners are not in order."""
    point = np.array(corner_m)
    count, edge = len(point), np.roll(point, -1, axis=0) - point

    def sides(number: int) -> np.ndarray:
        """Return on which side of the line along an edge each corner lies, 0 on it."""
        away = point - point[number]
        area = edge[number, 0] * away[:, 1] - edge[number, 1] * away[:, 0]
        return np.sign(np.where(np.abs(area) > ROUNDED * np.hypot(*edge[number]) * np.hypot(*away.T), area, 0.0))

    if not any(sides(number).any() for number in range(count)):
        raise refuse("", "encloses no area: all corners lie on a line; give the corners of an outline")
    for number in range(count - 2):
        side, after = sides(number), np.arange(number + 2, count)
        for other in after[side[after] * side[(after + 1) % count] < 0].tolist():
            theirs = sides(other)
            if theirs[number] * theirs[number + 1] < 0:
                message = f"the edges after corners {number + 1} and {other + 1} cross; give the corners in their order"
                raise refuse("", f"{message} around the outline")
    return corner_m


# Area of a triangle over the product of two of its sides, up to which its corners lie on a line.
ROUNDED = 1e-9
Outline = Annotated[tuple[Point2, ...], Field(min_length=3, max_length=MAX_CORNERS), AfterValidator(_enclosing)]
InputPath = Annotated[Path, AfterValidator(_a_path)]
# A file, or a network address, which is rejected unless the user allows it.
Address = Annotated[str, Field(max_length=LONGEST_PATH)]
InputSource = Annotated[InputPath | Address, BeforeValidator(_a_source)]


class Table(BaseModel):
    """A table of the scenario: frozen, and no key passes unnoticed."""

    # Built when a first one is made: most tables are validated as parts of others.
    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        allow_inf_nan=False,
        validate_default=True,
        defer_build=True,
    )

    if not TYPE_CHECKING:  # editors take the names and types of the arguments from the fields

        def __init__(self, **values: Any) -> None:
            try:
                super().__init__(**values)
            except ValidationError as error:
                raise ScenarioError(translate(error.errors(), type(self)), type(self).__name__) from None

        # Tables inside tables are validated by pydantic itself, which so collects the problems of all of them.
        __init__.__pydantic_base_init__ = True

        def __setattr__(self, name: str, value: Any) -> None:
            raise AttributeError(
                f"{type(self).__name__}.{name} cannot be set: a scenario does not change; "
                f"scenario.replace({{'...{name}': {value!r}}}) with the dotted key returns a changed copy"
            )

    def __deepcopy__(self, memo: dict[int, Any] | None = None) -> "Table":
        """Return the table itself, which does not change; pydantic copies each default that contains a mapping."""
        return self

    @model_validator(mode="after")
    def _no_conflict(self) -> "Table":
        for key, message in self._conflicts():
            raise refuse(key, message)
        return self

    def _conflicts(self) -> Conflicts:
        """Yield keys that contradict each other; only the first is reported."""
        yield from ()

    def to(self, kind: type[Made], **others: Any) -> Made:
        """Return a dataclass: its fields that have names of this table have its values, and `others` the rest."""
        same = {field.name for field in fields(kind)} - others.keys()  # type: ignore[arg-type]
        return kind(**{name: getattr(self, name) for name in same if hasattr(self, name)}, **others)

    def changed(self, *keys: str) -> list[str]:
        """Return those of some keys that do not have their defaults."""
        defaults: dict[str, Any] = type(self).model_fields
        return [key for key in keys if getattr(self, key) != defaults[key].default]

    def differing(self) -> dict[str, Any]:
        """Return the keys that differ from their defaults, and those that name a kind, in their JSON form."""
        dumped, differing = self.model_dump(mode="json", exclude_none=True), {}
        for name, field in type(self).model_fields.items():
            value = getattr(self, name)
            names_a_kind = get_origin(field.annotation) is Literal and len(get_args(field.annotation)) == 1
            default = None if field.is_required() else field.get_default(call_default_factory=True)
            if value is None or (value == default and not names_a_kind):
                continue
            shortened = _differing(value, dumped[name])
            if shortened != {}:
                differing[name] = shortened
        return differing

    def __str__(self) -> str:
        return tomli_w.dumps(self.differing()).rstrip()


def _differing(value: Any, dumped: Any) -> Any:
    """Return the JSON form of a value, its tables without defaults."""
    if isinstance(value, Table):
        return value.differing()
    if isinstance(value, tuple) and any(isinstance(entry, Table) for entry in value):
        return [_differing(entry, entry_dump) for entry, entry_dump in zip(value, dumped, strict=True)]
    if isinstance(value, dict):
        return {key: _differing(entry, dumped[key]) for key, entry in value.items() if key in dumped}
    return dumped


class Parameters(Table):
    """Parameters of a custom part: a frozen pydantic model that rejects unknown keys, like the built-in tables.

    Units belong into the names of the fields. `Real`, `Positive` and `NonNegative` of `sionna_radar.scenario` are
    numbers as the scenario's own tables take them: finite, and neither true nor text. Raises ScenarioError, with every
    problem, for values that do not fit.

    Examples
    --------
    >>> class Window(Parameters):
    ...     width_m: float = 2.0
    >>> Window(width_m=3.0).width_m
    3.0
    """


RULE = re.compile(r"\n.*\n-{3,}\n")
# By the end of a key's name, the longest first.
UNITS = {
    "_deg_per_ghz": "deg/GHz",
    "_ppm_per_k": "1e-6/K",
    "_mm_per_h": "mm/h",
    "_g_per_m3": "g/m³",
    "_g_cm3": "g/cm³",
    "_db_per_m": "dB/m",
    "_per_m2": "1/m²",
    "_m2": "m²",
    "_nepers": "Np",
    "_sigmas": "standard deviations",
    "_gaps": "widest gaps",
    "_cells": "range cells",
    "_pulses": "pulses",
    "_wavelengths": "wavelengths",
    "_percent": "%",
    "_mps2": "m/s²",
    "_mps": "m/s",
    "_mrad": "mrad",
    "_ppm": "1e-6",
    "_dbsm": "dB m²",
    "_dbm": "dBm",
    "_rpm": "1/min",
    "_per_s": "1/s",
    "_deg": "deg",
    "_hpa": "hPa",
    "_db": "dB",
    "_hz": "Hz",
    "_nm": "nm",
    "_nj": "nJ",
    "_ns": "ns",
    "_us": "µs",
    "_ms": "ms",
    "_mm": "mm",
    "_k": "K",
    "_c": "°C",
    "_m": "m",
    "_s": "s",
    "_w": "W",
}


def without_unit(name: str) -> tuple[str, str]:
    """Return a key's name without the suffix of its unit, and the unit; empty for none."""
    end = next((end for end in UNITS if name.endswith(end)), "")
    return name.removesuffix(end), UNITS.get(end, "")


def unit_of(name: str) -> str:
    """Return the unit from the suffix of a key's name; empty for none."""
    return without_unit(name)[1]


def summary(table: type[BaseModel]) -> str:
    """Return the docstring of a table without examples."""
    # The heading of a section stands above its rule.
    return RULE.split(inspect.cleandoc(table.__doc__ or "") + "\n")[0].strip()
