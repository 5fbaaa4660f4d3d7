"""The design of a study: a full factorial of listed values, sampled ranges, and the rows of a table.

Every row is combined with every sample, and these with every combination of the listed values, the last key fastest.
Samples fill their ranges evenly, in all keys jointly: a scrambled Sobol sequence (Owen 1998) or a Latin hypercube
(McKay, Beckman & Conover 1979), both of `scipy.stats.qmc` and drawn from the scenario's seed.

A design is written as `KEY=V1,V2,...`, `KEY=LOW:HIGH`, `sobol:64`, and tables of settings.
"""

import csv
import io
import math
import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any, Literal, NoReturn, cast, get_args

import numpy as np
from jaxtyping import Float

from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.input_file import parse_toml, read_text, shown
from sionna_radar.foundation.randomness import Stream
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.overrides import LONGEST_ASSIGNMENT, parse_value, resolve_paths, value_at

Setting = dict[str, Any]
SamplerName = Literal["sobol", "lhs"]
MAX_SETTINGS = 10_000
# Significant digits of a sampled value: enough for any study, and readable.
DIGITS = 6
# Longest shown value, in characters.
LONGEST_SHOWN = 48


@dataclass(frozen=True, kw_only=True)
class Axis:
    """One varied key of the scenario and its values.

    crossed: True if each value is flown with every combination of the other keys; False if sampled, or from a table.
    """

    key: str
    values: tuple[Any, ...]
    crossed: bool = True


@dataclass(frozen=True, kw_only=True)
class Span:
    """A sampled range of a key, uniform or log-uniform.

    option: that gave it, named in errors.

    Raises ScenarioError for an empty or infinite range, or a logarithmic one that is not positive.
    """

    key: str
    low: float
    high: float
    logarithmic: bool = False
    option: str = field(default="--vary", compare=False, repr=False)

    def __post_init__(self) -> None:
        text = f"{self.low:g}:{self.high:g}"
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            refuse(f"{self.key} = {text} is no range; give finite LOW:HIGH with LOW below HIGH", self.option)
        if self.logarithmic and self.low <= 0:
            refuse(f"{self.key} = {text}:log has no logarithm at {self.low:g}; give a LOW above 0", self.option)

    def at(
        self, fraction: Float[np.ndarray, " sample"], *, whole: bool, digits: int = DIGITS
    ) -> list[float] | list[int]:
        """Return the values at fractions, from 0 to below 1, of the interval from low to high."""
        if whole:
            # Every whole number, both ends included, has the same fraction of the interval.
            low, high = math.ceil(self.low), math.floor(self.high) + 1
            if low >= high:
                text = f"{self.key} = {self.low:g}:{self.high:g}"
                refuse(f"{text} holds no whole number, which that key must be", self.option)
            return [int(v) for v in np.floor(self._between(float(low), float(high), fraction))]
        drawn = [float(f"{value:.{digits}g}") for value in self._between(self.low, self.high, fraction)]
        return [min(max(value, self.low), self.high) for value in drawn]

    def _between(self, low: float, high: float, fraction: Float[np.ndarray, " sample"]) -> Float[np.ndarray, " sample"]:
        if self.logarithmic:
            return np.asarray(low * (high / low) ** fraction)
        return low + (high - low) * fraction


def one_setting(listed: Iterable[Axis], spans: Sequence[Span]) -> Setting:
    """Return the first of listed values, and of each range a whole number if it holds one, or its low end."""
    whole = {span.key: math.ceil(span.low) for span in spans}
    low = {span.key: span.low for span in spans if whole[span.key] > span.high}
    return {axis.key: axis.values[0] for axis in listed} | whole | low


@dataclass(frozen=True, kw_only=True)
class Sampler:
    """Sampling method of the ranges, and number of samples."""

    name: SamplerName
    count: int

    def __post_init__(self) -> None:
        if self.name not in get_args(SamplerName) or not 1 <= self.count <= MAX_SETTINGS:
            message = f"{self.name}:{self.count} is no sample; give sobol:N or lhs:N with N from 1 to {MAX_SETTINGS:,}"
            refuse(message, "--sample")

    def shares(self, keys: int, seed: int) -> Float[np.ndarray, "sample key"]:
        """Return points of the unit cube, one axis for each key."""
        from scipy.stats import qmc

        engine = {"sobol": qmc.Sobol, "lhs": qmc.LatinHypercube}[self.name]
        rng = np.random.default_rng([seed, int(Stream.SAMPLES)])
        with warnings.catch_warnings():
            # Fewer points than the next power of two are slightly less even, which does not justify more flights.
            warnings.filterwarnings("ignore", message="The balance properties", category=UserWarning)
            return np.asarray(engine(keys, rng=rng).random(self.count))


@dataclass(frozen=True, kw_only=True)
class Design:
    """Varied keys and values of a study; see the module.

    listed: keys of the full factorial.
    spans, sampler: keys sampled within ranges.
    rows: explicit settings; a key missing from a row keeps its value.
    seeds_alone: nothing else is varied.

    Raises ScenarioError for a key that is varied twice, ranges without a sampler or vice versa, and nothing to vary.
    """

    listed: tuple[Axis, ...] = ()
    spans: tuple[Span, ...] = ()
    sampler: Sampler | None = None
    rows: tuple[Setting, ...] = ()
    seeds_alone: bool = False

    def __post_init__(self) -> None:
        if self.spans and self.sampler is None:
            refuse(f"{self.spans[0].key} is given a range; say how often it is sampled, e.g. --sample sobol:64")
        if self.sampler is not None and not self.spans:
            refuse("no range is there to sample; give at least one --vary KEY=LOW:HIGH", "--sample")
        keys = self.keys
        if not keys and not self.seeds_alone:  # also where all values of a table are empty
            refuse("nothing is varied; give at least one KEY=V1,V2,..., or several --repeat")
        twice = [key for index, key in enumerate(keys) if key in keys[:index]]
        if twice:
            refuse(f"{twice[0]} is varied twice; name all its values once")
        if len(self) > MAX_SETTINGS:
            refuse(f"{len(self):,} settings are more than {MAX_SETTINGS:,}; name fewer values, samples or rows")

    @staticmethod
    def of(varied: "Design | Sequence[Axis] | Mapping[str, Sequence[Any]]") -> "Design":
        """Return a design, converted from axes or from values by key if necessary."""
        if isinstance(varied, Design):
            return varied
        if isinstance(varied, Mapping):
            varied = [Axis(key=key, values=tuple(values)) for key, values in varied.items()]
        return Design(listed=tuple(varied))

    def __len__(self) -> int:
        samples = self.sampler.count if self.sampler else 1
        return max(len(self.rows), 1) * samples * math.prod(len(axis.values) for axis in self.listed)

    @property
    def keys(self) -> tuple[str, ...]:
        """The varied keys: those of the table, sampled ones, listed ones."""
        of_rows = dict.fromkeys(key for row in self.rows for key in row)
        return (*of_rows, *(span.key for span in self.spans), *(axis.key for axis in self.listed))

    def settings(self, base: Scenario | None = None) -> list[Setting]:
        """Return all settings in the order flown; ranges need the scenario, whose seed draws the samples."""
        listed = [
            dict(zip([axis.key for axis in self.listed], values, strict=True))
            for values in product(*(axis.values for axis in self.listed))
        ]
        return [
            row | sample | values for row in self.rows or ({},) for sample in self._samples(base) for values in listed
        ]

    def axes(self, settings: Sequence[Setting]) -> tuple[Axis, ...]:
        """Return the varied keys with their values in some settings."""
        listed = {axis.key: axis for axis in self.listed}
        return tuple(listed.get(key) or _axis(key, settings) for key in self.keys)

    def _samples(self, base: Scenario | None) -> list[Setting]:
        if self.sampler is None or base is None:
            return [{}]
        shares = self.sampler.shares(len(self.spans), base.seed)
        columns = [
            span.at(share, whole=is_whole(base, span.key)) for span, share in zip(self.spans, shares.T, strict=True)
        ]
        keys = [span.key for span in self.spans]
        return [dict(zip(keys, values, strict=True)) for values in zip(*columns, strict=True)]


def _axis(key: str, settings: Sequence[Setting]) -> Axis:
    values: list[Any] = []
    for setting in settings:
        if key in setting and setting[key] not in values[-1:]:
            values.append(setting[key])
    distinct = {repr(value): value for value in values}  # lists cannot be hashed
    return Axis(key=key, values=tuple(distinct.values()), crossed=False)


def is_whole(base: Scenario, key: str) -> bool:
    """Return True if a key of a scenario holds whole numbers only."""
    place, _, name = key.rpartition(".")
    table = value_at(base, place) if place else base
    known = getattr(type(table), "model_fields", {}).get(name)
    kinds = () if known is None else (get_args(known.annotation) or (known.annotation,))
    return int in kinds and float not in kinds


def label(setting: Mapping[str, Any]) -> str:
    """Return a setting in short: the last part of each key, and its value."""
    if not setting:
        return "nothing changed"
    return ", ".join(f"{key.split('.')[-1]} = {short(value)}" for key, value in setting.items())


def short(value: Any) -> str:
    """Return a readable value of a setting; long ones, such as lists of tables, are abbreviated."""
    text = f"{value:g}" if isinstance(value, float) else str(value)
    return text if len(text) <= LONGEST_SHOWN else f"{text[: LONGEST_SHOWN - 16]} ... {text[-11:]}"


def refuse(message: str, field: str = "--vary") -> NoReturn:
    """Raise ScenarioError for an invalid design."""
    raise ScenarioError.of_option(field, message)


NUMBER = r"[+-]?(?:[0-9][0-9_]*\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
RANGE = re.compile(rf"\s*({NUMBER})\s*:\s*({NUMBER})\s*(:\s*log)?\s*")
REMEDY = "give a CSV file: dotted keys in the first line, a setting in each other one"


def parse_design(assignments: Iterable[str], sample: str | None = None, table: Path | None = None) -> Design:
    """Return the design given by the options `--vary`, `--sample` and `--table`.

    Values are TOML, and bare words are strings; a range may end in `:log`. Raises ScenarioError without a key or value,
    for a value given twice and as `Design` does, and InputFileError if the table cannot be read.
    """
    listed, spans = parse_varied(assignments)
    return Design(
        listed=listed,
        spans=spans,
        sampler=None if sample is None else parse_sampler(sample),
        rows=() if table is None else read_settings(table),
    )


def parse_varied(assignments: Iterable[str], option: str = "--vary") -> tuple[tuple[Axis, ...], tuple[Span, ...]]:
    """Return the listed keys and the ranges of assignments; raises ScenarioError as `parse_design`."""
    listed: list[Axis] = []
    spans: list[Span] = []
    for assignment in assignments:
        key, separator, text = (part.strip() for part in assignment.partition("="))
        if not separator or not key or not text:
            refuse(f"{shown(assignment)} is not KEY=V1,V2,... or KEY=LOW:HIGH", option)
        span = RANGE.fullmatch(text)
        if span:
            low, high, logarithmic = span.groups()
            spans.append(Span(key=key, low=float(low), high=float(high), logarithmic=bool(logarithmic), option=option))
        else:
            listed.append(Axis(key=key, values=_values(key, text, option)))
    return tuple(listed), tuple(spans)


def parse_sampler(text: str) -> Sampler:
    """Return the sampler for `sobol:N` or `lhs:N`; raises ScenarioError for anything else."""
    name, _, count = text.strip().partition(":")
    if name not in get_args(SamplerName) or not re.fullmatch("[0-9]{1,9}", count):
        refuse(f"{shown(text)} is no sample; give sobol:N or lhs:N, such as sobol:64", "--sample")
    return Sampler(name=cast(SamplerName, name), count=int(count))


def read_settings(path: Path) -> tuple[Setting, ...]:
    """Return the settings of a CSV file: dotted keys in its first line, and one setting per further line.

    Values are those of `--set`; an empty one leaves the key unchanged, the word none removes it. A line of commas only
    is the scenario itself. Relative paths of input files are relative to the table's folder, or else to the working
    folder. Raises InputFileError for another table or a repeated setting, ScenarioError for an invalid value.
    """
    text = read_text(path, "--table", REMEDY)
    try:
        reader = csv.reader(io.StringIO(text, newline=""), strict=True)
        lines = [line for line in reader if len(line) > 1 or any(map(str.strip, line))]
    except csv.Error as error:
        _refuse(path, f"it is not CSV ({error})")
    if len(lines) < 2:
        _refuse(path, "it holds no setting")
    if len(lines) - 1 > MAX_SETTINGS:
        _refuse(path, f"it holds {len(lines) - 1:,} settings, more than {MAX_SETTINGS:,}")
    header = [name.strip() for name in lines[0]]
    if not all(header) or len(set(header)) < len(header):
        _refuse(path, "a column has no key, or that of another one")
    settings = [_setting(path, number, header, line) for number, line in enumerate(lines[1:], 1)]
    numbers: dict[str, int] = {}
    for number, setting in enumerate(settings, 1):
        earlier = numbers.setdefault(repr(setting), number)
        if earlier != number:
            _refuse(path, f"settings {earlier} and {number} are the same")
    return tuple(settings)


def _setting(path: Path, number: int, header: list[str], line: list[str]) -> Setting:
    if len(line) != len(header):
        _refuse(path, f"setting {number} has {len(line)} values for {len(header)} keys")
    setting = {
        key: parse_value(key, text.strip()) for key, text in zip(header, line, strict=True) if text.strip() != ""
    }
    for key, value in setting.items():
        named = {key.rpartition(".")[2]: value}
        resolve_paths(named, path.parent)
        setting[key] = next(iter(named.values()))
    return setting


def _refuse(path: Path, message: str) -> NoReturn:
    raise InputFileError(f"--table {shown(path)}: {message}; {REMEDY}")


def _values(key: str, text: str, option: str) -> tuple[Any, ...]:
    if len(text) > LONGEST_ASSIGNMENT:
        table = ", or give them as a --table" if option == "--vary" else ""
        refuse(f"{shown(key)[1:-1]} has values of {len(text):,} characters; name fewer{table}", option)
    try:
        values = tuple(parse_toml(f"values = [{text}]")["values"])
    except ValueError:
        # Some are bare words: split at the commas outside brackets.
        values = tuple(parse_value(key, part.strip()) for part in re.split(r",(?![^\[]*\])", text))
    if "" in values:
        refuse(f"{key} has an empty value in {shown(text)}; take out the extra comma", option)
    names = [repr(value) for value in values]
    repeated = [value for index, value in enumerate(values) if names[index] in names[:index]]
    if repeated:
        refuse(f"{key} takes the value {repeated[0]!r} twice; name it once", option)
    return values
