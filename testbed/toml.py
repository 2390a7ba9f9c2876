"""TOML files: read into a checked model, written from plain data."""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args

from pydantic import BaseModel, Field, ValidationError

from testbed.errors import HeftError, InvalidValueError, nearest, short
from testbed.files import read_file

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
MOST_BYTES, MOST_ENTRIES, MOST_DEPTH, MOST_LINES = 2**20, 100_000, 32, 20
"""Largest size of a file [B], number of its values, and depth of its tables; number of errors that are listed."""
LARGEST = 1e15
"""Largest number in a file, above every quantity in SI units and every seed."""
_PART_OF_KEY = r"""(?:[\w-]+|"[^"\n]*"|'[^'\n]*')[ \t]*\.[ \t]*"""
_DEEP_KEY = re.compile(rf"(?<![\w-])(?:{_PART_OF_KEY}){{{MOST_DEPTH}}}", re.ASCII)
"""Dotted key that is too deep: the parser's memory grows with the square of the depth."""
MOST_OF = {"m": 10.0, "kg": 50.0}
"""Largest length and mass on a bench, by the unit at the end of a field's name."""
FileModel = TypeVar("FileModel", bound=BaseModel)


class InvalidFileError(HeftError, ValueError):
    """TOML file that cannot be read or does not fit its schema; the message has all errors, each with its field."""


def load_toml(path: Path, model: type[FileModel]) -> FileModel:
    """Read a TOML file into a pydantic model.

    Raises:
        InvalidFileError: unreadable, not TOML, or not fitting; the message has a line for each error.
    """
    try:
        text = read_file(path, MOST_BYTES).decode()
        if _DEEP_KEY.search(text):
            raise ValueError(f"nested deeper than {MOST_DEPTH}")
        data = tomllib.loads(text)
        _check_size(data)
    except OSError as error:
        raise InvalidFileError(f"{path}: cannot be read: {error.strerror}") from None
    except RecursionError:
        raise InvalidFileError(f"{path}: cannot be read as TOML: nested deeper than {MOST_DEPTH}") from None
    except ValueError as error:  # UnicodeDecodeError and TOMLDecodeError too
        raise InvalidFileError(f"{path}: cannot be read as TOML: {short(error, str)}") from None
    return fitted(path, data, model)


def fitted(path: Path, data: Any, model: type[FileModel]) -> FileModel:
    """Validate the content of a file by its pydantic model.

    Raises:
        InvalidFileError: content that does not fit; the message has a line for each error.
    """
    if lines := [f"{path}: {line}" for line in _beyond_a_bench(data)]:
        raise InvalidFileError("\n".join(lines[:MOST_LINES]))
    try:
        return model.model_validate(data)
    except ValidationError as error:
        lines = explained(error, model)
        more = [f"and {len(lines) - MOST_LINES} more"] if len(lines) > MOST_LINES else []
        raise InvalidFileError("\n".join(f"{path}: {line}" for line in [*lines[:MOST_LINES], *more])) from None


def _check_size(data: Any) -> None:
    """Raise ValueError for data that is too deep or has too many values or too large numbers."""
    values, level, depth = 0, [data], 0
    while level:
        depth, values = depth + 1, values + len(level)
        if depth > MOST_DEPTH:
            raise ValueError(f"nested deeper than {MOST_DEPTH}")
        if values > MOST_ENTRIES:
            raise ValueError(f"more than {MOST_ENTRIES} values")
        for value in level:
            if isinstance(value, int | float) and LARGEST < abs(value) < math.inf:
                raise ValueError(f"{short(value)} is larger than {LARGEST:g}, which no quantity here is")
        inner = [
            value.values() if isinstance(value, dict) else value for value in level if isinstance(value, dict | list)
        ]
        level = [value for values_of in inner for value in values_of]


def _beyond_a_bench(value: Any, path: tuple[str, ...] = ()) -> Iterator[str]:
    """Error lines of the fields whose value, in the unit at the end of their name, exceeds `MOST_OF`."""
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _beyond_a_bench(inner, (*path, str(name)))
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from _beyond_a_bench(inner, (*path, str(index)))
    elif isinstance(value, int | float) and path:
        unit = next((name for name in reversed(path) if not name.isdecimal()), "").rpartition("_")[2]
        if abs(value) > MOST_OF.get(unit, math.inf):
            most = f"at most {MOST_OF[unit]:g} {unit}; is it of another unit?"
            yield f"{'.'.join(path)}: got {value:g} {unit}; allowed: {most}"


def explained(error: ValidationError, model: type[BaseModel]) -> list[str]:
    """Lines of a validation error, one per error, with the fields of the file."""
    items = [dict(item) for item in error.errors()]
    relevant = [item for item in items if not _wrong_branch(item)] or items
    return list(dict.fromkeys(_explain(item, model) for item in relevant))


def _tables(annotation: Any) -> list[type[BaseModel]]:
    """Models in an annotation, also in a list or a union."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [table for inner in get_args(annotation) for table in _tables(inner)]


def _known_fields(model: type[BaseModel], path: Sequence[Any]) -> list[str]:
    """Fields of the table at an error's path."""
    tables = [model]
    for part in path:
        inner = [_tables(table.model_fields[part].annotation) for table in tables if part in table.model_fields]
        tables = [table for found in inner for table in found] or tables  # a list's index, a branch of a union
    return sorted({name for table in tables for name in table.model_fields})


_BRANCHES = ("float", "constrained-float", "str", "int")
"""pydantic's names of the scalar branch of "a number or a list"."""


def _wrong_branch(item: dict[str, Any]) -> bool:
    """True if the error is of the other branch of "a number or a list" than that of the input."""
    branch = next((str(p) for p in item["loc"] if str(p) in _BRANCHES or "[" in str(p)), None)
    return branch is not None and (
        (item["type"] == "list_type" and not isinstance(item["input"], list))
        or (branch in _BRANCHES and isinstance(item["input"], list))
    )


def _joined(table: str, field: str) -> str:
    """Name of a field in a file, from the checked table and the field in the error of its class."""
    path = [] if table == "file" else table.split(".")
    inner = field.split(".") if field else []
    inner = inner[1:] if inner[1:] and inner[0][:1].isupper() else inner  # Rotate.speed
    shared = next((k for k in range(len(inner), 0, -1) if path[-k:] == inner[:k]), 0)
    return ".".join([*path, *inner[shared:]])


def _explain(item: dict[str, Any], model: type[BaseModel]) -> str:
    """Line of one error: field, given value, allowed values."""
    field = ".".join(str(p) for p in item["loc"] if str(p) not in _BRANCHES and "[" not in str(p)) or "file"
    cause = (item.get("ctx") or {}).get("error")
    if isinstance(cause, InvalidValueError):
        name = _joined(field, cause.field)
        return f"{short(name, str)}: got {short(cause.given)}; allowed: {cause.allowed}"
    if item["type"] == "missing":
        return f"{field}: missing"
    if item["type"] == "extra_forbidden":
        *path, name = item["loc"]
        hint = nearest(str(name), _known_fields(model, path), 0.6)
        return f"{short(field, str)}: no such field; got {short(item['input'])}{hint}"
    allowed = item["msg"].removeprefix("Input should be ")
    if item["type"] == "string_pattern_mismatch":  # every pattern is one of folder names
        allowed = "letters, digits and any of _ . -, without spaces"
    if item["type"] == "list_type" and isinstance(item["input"], str | int | float):
        allowed = f"a list: {json.dumps([item['input']])}"
    if item["type"] in ("model_type", "dict_type"):
        allowed = f"a table: [{field}]"
    return f"{short(field, str)}: got {short(item['input'])}; allowed: {allowed}"


def toml_text(table: Mapping[str, Any]) -> str:
    """TOML of plain data: first its fields, then a table for each mapping; None is left out."""
    lines = _fields({name: value for name, value in table.items() if not isinstance(value, Mapping)})
    for name, inner in table.items():
        if isinstance(inner, Mapping):
            nested = inner and all(isinstance(value, Mapping) for value in inner.values())
            tables = {f"{_key(name)}.{_key(k)}": v for k, v in inner.items()} if nested else {_key(name): inner}
            for header, fields in tables.items():
                lines += ["", f"[{header}]", *_fields(fields)]
    return "\n".join(lines) + "\n"


def toml_lists(**lists: Sequence[Mapping[str, Any]]) -> str:
    """TOML of lists of tables, for after `toml_text`: a `[[name]]` for each table."""
    return "".join(f"\n[[{name}]]\n{toml_text(table)}" for name, tables in lists.items() for table in tables)


def _fields(table: Mapping[str, Any]) -> list[str]:
    return [f"{_key(name)} = {_value(value)}" for name, value in table.items() if value is not None]


def _key(name: str) -> str:
    return name if name.replace("_", "").replace("-", "").isascii() and name.isidentifier() else _quoted(name)


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{" + ", ".join(_fields(value)) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_value, value)) + "]"
    if isinstance(value, float):
        return float.__repr__(value)  # inf in TOML, Infinity in JSON
    return _quoted(value)


def _quoted(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")  # raw in JSON, refused by TOML
