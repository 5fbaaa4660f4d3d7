"""What a study varies, as it is written: `KEY=V1,V2,...`, `KEY=LOW:HIGH`, `sobol:64`, and tables of settings."""

import csv
import io
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NoReturn, cast, get_args

from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import parse_toml, read_text, shown
from sionna_radar.scenario.overrides import LONGEST_ASSIGNMENT, parse_value, resolve_paths
from sionna_radar.studies.design import MAX_SETTINGS, Axis, Design, Sampler, SamplerName, Setting, Span, refuse

NUMBER = r"[+-]?(?:[0-9][0-9_]*\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
RANGE = re.compile(rf"\s*({NUMBER})\s*:\s*({NUMBER})\s*(:\s*log)?\s*")
REMEDY = "give a CSV file: dotted keys in the first line, a setting in each other one"


def parse_design(assignments: Iterable[str], sample: str | None = None, table: Path | None = None) -> Design:
    """Return what the options `--vary`, `--sample` and `--table` say.

    Values are TOML, and bare words are strings; a range may end in `:log`.

    Raises
    ------
    ScenarioError
        No key, no value, a value given twice; or as `Design`.
    InputFileError
        The table cannot be read.

    """
    listed: list[Axis] = []
    spans: list[Span] = []
    for assignment in assignments:
        key, separator, text = (part.strip() for part in assignment.partition("="))
        if not separator or not key or not text:
            refuse(f"{shown(assignment)} is not KEY=V1,V2,... or KEY=LOW:HIGH")
        span = RANGE.fullmatch(text)
        if span:
            low, high, logarithmic = span.groups()
            spans.append(Span(key=key, low=float(low), high=float(high), logarithmic=logarithmic is not None))
        else:
            listed.append(Axis(key=key, values=_values(key, text)))
    return Design(
        listed=tuple(listed),
        spans=tuple(spans),
        sampler=None if sample is None else parse_sampler(sample),
        rows=() if table is None else read_settings(table),
    )


def parse_sampler(text: str) -> Sampler:
    """Return the sampler that `sobol:N` or `lhs:N` names; raises ScenarioError for anything else."""
    name, _, count = text.strip().partition(":")
    if name not in get_args(SamplerName) or not re.fullmatch("[0-9]{1,9}", count):
        refuse(f"{shown(text)} is no sample; give sobol:N or lhs:N, such as sobol:64", "--sample")
    return Sampler(name=cast(SamplerName, name), count=int(count))


def read_settings(path: Path) -> tuple[Setting, ...]:
    """Return the settings of a CSV file: dotted keys in its first line, and a setting in each other one.

    Values are those of `--set`; an empty one leaves the key as it is, the word none takes it out. A line of nothing but
    commas is the scenario itself. Relative paths of input files are relative to the table's folder, or else to the
    working folder.

    Raises
    ------
    InputFileError
        It cannot be read, is not such a table, or holds a setting twice.
    ScenarioError
        A value is none that a scenario holds.

    """
    text = read_text(path, "--table", REMEDY)
    try:
        read = csv.reader(io.StringIO(text, newline=""), strict=True)
        lines = [line for line in read if len(line) > 1 or any(map(str.strip, line))]
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
    seen: dict[str, int] = {}
    for number, setting in enumerate(settings, 1):
        earlier = seen.setdefault(repr(setting), number)
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
    text = f"--table {shown(path)}: {message}; {REMEDY}"
    raise InputFileError(text)


def _values(key: str, text: str) -> tuple[Any, ...]:
    if len(text) > LONGEST_ASSIGNMENT:
        refuse(f"{shown(key)[1:-1]} has values of {len(text):,} characters; name fewer, or give them as a --table")
    try:
        values = tuple(parse_toml(f"values = [{text}]")["values"])
    except ValueError:
        # Some are bare words: split at the commas outside brackets.
        values = tuple(parse_value(key, part.strip()) for part in re.split(r",(?![^\[]*\])", text))
    if "" in values:
        refuse(f"{key} has an empty value in {shown(text)}; take out the extra comma")
    names = [repr(value) for value in values]
    repeated = [value for index, value in enumerate(values) if names[index] in names[:index]]
    if repeated:
        refuse(f"{key} takes the value {repeated[0]!r} twice; name it once")
    return values
