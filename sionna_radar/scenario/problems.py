"""Error messages of scenarios: pydantic's validation errors in the terms of a TOML file."""

from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from typing import Any, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from sionna_radar.foundation.errors import Problem
from sionna_radar.foundation.input_file import compact, shown

# By the type of pydantic's error; the fields are those of its context.
WORDS = {
    "greater_than": "must be greater than {gt}",
    "greater_than_equal": "must be at least {ge}",
    "less_than": "must be less than {lt}",
    "less_than_equal": "must be at most {le}",
    "finite_number": "must be a finite number",
    "float_type": "must be a number without quotes",
    "float_parsing": "must be a number without quotes",
    "int_type": "must be a whole number",
    "int_from_float": "must be a whole number",
    "int_parsing": "must be a whole number",
    "int_parsing_size": "must be a smaller whole number",
    "bool_type": "must be true or false",
    "bool_parsing": "must be true or false",
    "string_type": "must be text in quotes",
    "string_unicode": "must be text in UTF-8",
    "string_too_short": "must be text that is not empty",
    "path_type": "must be a path in quotes",
    "tuple_type": "must be a list such as [1.0, 2.0]",
    "list_type": "must be a list such as [1.0, 2.0]",
    "too_short": "must have at least {min_length} entries",
    "too_long": "must have at most {max_length} entries",
}
MISSING = "missing; add it"
TABLE_TYPES = ("model_type", "model_attributes_type", "dict_type", "dataclass_type")
# Location entries that pydantic adds for a key with several kinds of value.
KINDS_OF_VALUE = ("float", "int", "constrained-float", "constrained-int")


def translate(errors: Sequence[Mapping[str, Any]], model: type[BaseModel]) -> list[Problem]:
    """Return the problems of a validation, the first of each key, in their order.

    errors: result of `ValidationError.errors()`.
    model: the validated table; its keys are suggested for misspelt ones.
    """
    problems: dict[str, Problem] = {}
    for error in errors:
        if error["type"] == "too_short" and len(error["input"]) >= error["ctx"]["min_length"]:
            continue  # it counts only valid entries; the invalid ones have their own errors
        if _other_than_a_list(error, errors):
            continue
        problem = _problem(error, model)
        problems.setdefault(problem.field, problem)
    return list(problems.values())


def _other_than_a_list(error: Mapping[str, Any], errors: Sequence[Mapping[str, Any]]) -> bool:
    """Return True if an error only rejects a list as a number, where a list is allowed and has its own errors."""
    parent, kind = error["loc"][:-1], error["loc"][-1:]
    if not isinstance(error["input"], list | tuple) or not kind or kind[0] not in KINDS_OF_VALUE:
        return False
    siblings = (
        other["loc"][len(parent)] for other in errors if other["loc"][: len(parent)] == parent and other is not error
    )
    return any(str(sibling).startswith("tuple[") for sibling in siblings)


def nearest(word: str, known: Sequence[str]) -> str:
    """Return a question that suggests the closest known word, with a leading space; empty without a close match."""
    folded = {name.lower(): name for name in known}
    matches = get_close_matches(word.lower()[:100], list(folded), n=1, cutoff=0.6)
    return f" Did you mean {folded[matches[0]]}?" if matches else ""


def unknown(word: object, known: Sequence[str]) -> str:
    """Return the message for an unknown word."""
    return f"{shown(word)} is unknown; give one of {', '.join(known)}.{nearest(str(word), known)}"


def _problem(error: Mapping[str, Any], model: type[BaseModel]) -> Problem:
    key, kind, value = _key(error["loc"]), error["type"], error["input"]
    context = error.get("ctx", {})
    match kind:
        case "scenario":
            field = context.get("field", "")
            return Problem(".".join([*key, *([field] if field else [])]) or "scenario", error["msg"])
        case "extra_forbidden":
            return Problem(".".join(key), f"unknown key; remove it or correct its spelling.{_other_key(error, model)}")
        case "missing":
            return Problem(".".join(key), MISSING)
        case "union_tag_not_found":
            tag = context["discriminator"].strip("'")
            names = [str(name) for table in _tables_at(error["loc"], model) for name in _tag_values(table, tag)]
            message = f"missing; give one of {', '.join(dict.fromkeys(names))}" if names else MISSING
            return Problem(".".join([*key, *([] if tag.endswith("()") else [tag])]), message)
        case "union_tag_invalid":
            options = [tag.strip(" '") for tag in context["expected_tags"].split(",")]
            tag = context["discriminator"].strip("'")
            return Problem(".".join([*key, tag]), unknown(context["tag"], options))
        case "literal_error":
            options = [word.strip(" '") for word in context["expected"].replace(" or ", ",").split(",")]
            requirement = f"must be {'one of ' * (len(options) > 1)}{context['expected'].replace(' or ', ', ')}"
            suggestion = nearest(value, options) if isinstance(value, str) else ""
            return Problem(".".join(key), f"{requirement}, not {shown(value)}{'.' if suggestion else ''}{suggestion}")
        case _ if kind in TABLE_TYPES:
            name = ".".join(key)
            requirement = f"must be a table, [{name}] with its keys below" if name else "must be tables of keys"
        case _ if kind in WORDS:
            bounds = {name: compact(bound) for name, bound in context.items() if isinstance(bound, int | float)}
            requirement = WORDS[kind].format(**context | bounds)
        case _:
            requirement = error["msg"].lower()
    return Problem(".".join(key), f"{requirement}, not {shown(value)}")


def _key(location: Sequence[str | int]) -> list[str]:
    """Return the key of a location as it appears in the file, without pydantic's additions."""
    key = [shown(part)[1:-1] if isinstance(part, str) else str(part) for part in location]
    start = 1
    if key[:1] == ["materials"]:
        start = 2
        if key[2:3] == ["medium"] and len(key) > 3:
            del key[3]  # the kind of the medium is not a key of the file
    return [*key[:start], *(p for p in key[start:] if p not in KINDS_OF_VALUE and not p.startswith("tuple["))]


def _other_key(error: Mapping[str, Any], model: type[BaseModel]) -> str:
    """Return a question that suggests the intended key for a misspelt or misplaced one; empty without a match."""
    *parents, wrong_key = error["loc"]
    tables = _tables_at(parents, model)
    full_key = ".".join(map(str, error["loc"]))
    owners = [t for t in tables if wrong_key in t.model_fields and _tag_values(t, "kind", "mode")]
    if owners:  # of another part that may stand in the same place
        names = " or ".join(repr(value) for table in owners for value in _tag_values(table, "kind", "mode"))
        return f" It belongs to {'kind' if 'kind' in owners[0].model_fields else 'mode'} = {names}."
    elsewhere = [key for key in _all_keys(model) if key.rpartition(".")[2] == wrong_key and key != full_key]
    if parents[:1] == ["materials"]:  # of another model, which may stand in the same place
        elsewhere = [key for key in elsewhere if not key.startswith("materials.")]
    if elsewhere:
        return f" Did you mean {elsewhere[0]}?"
    return nearest(str(wrong_key), [name for table in tables for name in table.model_fields if name != wrong_key])


def _tables_at(location: Sequence[str | int], model: type[BaseModel]) -> list[type[BaseModel]]:
    tables: list[type[BaseModel]] = [model]
    for part in location:
        fields = [_allowed(table.model_fields[part]) for table in tables if part in table.model_fields]
        tagged = [table for table in tables if part in _tag_values(table, "kind", "model")]
        tables = [table for allowed in fields for table in allowed] if fields else tagged or tables
    return tables


def _tag_values(table: type[BaseModel], *tags: str) -> tuple[Any, ...]:
    """Return the values of the first of some keys that a table has, which select it among others in its place."""
    field = next((table.model_fields[tag] for tag in tags if tag in table.model_fields), None)
    return get_args(field.annotation) if field else ()


def _allowed(field: FieldInfo) -> list[type[BaseModel]]:
    chosen = [table for check in field.metadata for table in _tables(check)]
    return chosen or _tables(field.annotation)


def _tables(annotation: Any) -> list[type[BaseModel]]:
    if hasattr(annotation, "tables"):
        return list(annotation.tables())
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [table for part in get_args(annotation) for table in _tables(part)]


def _all_keys(model: type[BaseModel], prefix: str = "", ancestors: tuple[type[BaseModel], ...] = ()) -> Iterator[str]:
    for name, field in model.model_fields.items():
        yield prefix + name
        for table in _allowed(field):
            if table not in (model, *ancestors):  # a table may hold tables of its own kind
                inner = f"{name}.NAME" if get_origin(field.annotation) is dict else name
                yield from _all_keys(table, f"{prefix}{inner}.", (model, *ancestors))
