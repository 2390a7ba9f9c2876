"""Objects as TOML files: a user adds an object without touching code.

name = "L2"
[blocks]
layout = ["1", "1", "1", "111"]              # rows top to bottom; "1" is a block
mass_kg = [0.4, 0.1, 0.1, 0.4, 0.4, 0.4]     # bottom row first, left to right; one number for all alike
friction = 0.5                               # or a list, one a friction group, with friction_group below
friction_group = [0, 0, 0, 0, 0, 0]          # optional: which friction each block has
size_m = 0.05                                # optional: side of a block
height_m = 0.03                              # optional: height of a block
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from testbed.blocks import block_object, parse_layout
from testbed.errors import HeftError, InvalidValueError
from testbed.objects import ObjectModel
from testbed.resources import asset_folder, find_file, library_names

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
FileModel = TypeVar("FileModel", bound=BaseModel)


class InvalidFileError(HeftError, ValueError):
    """A TOML file that cannot be read or does not fit its schema: every error at once, each with its field."""


class Blocks(BaseModel):
    """The [blocks] table of an object file."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    layout: list[str]
    mass_kg: Positive | list[NonNegative]
    friction: NonNegative | list[NonNegative] = 0.5
    friction_group: list[int] | None = None
    size_m: Positive = 0.05
    height_m: Positive = 0.03

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        parse_layout(self.layout)
        return self


class ObjectFile(BaseModel):
    """A whole object file."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[\w.-]+$")]
    blocks: Blocks

    def build(self, grid: int) -> ObjectModel:
        """The object with grid x grid particles a block."""
        b = self.blocks
        cells = parse_layout(b.layout)
        friction: list[float] = list(b.friction) if isinstance(b.friction, list) else [b.friction]
        if not friction:
            raise InvalidValueError("blocks.friction", friction, "a number >= 0, or a list of one or more")
        groups = b.friction_group
        if groups is None and len(friction) == 1:
            groups = [0] * len(cells)
        if groups is None or len(groups) != len(cells) or set(groups) - {-1} != set(range(len(friction))):
            allowed = (
                f"{len(cells)} integers, one a block, that use every friction from 0 to {len(friction) - 1}, or -1"
            )
            raise InvalidValueError("blocks.friction_group", groups, allowed)
        mass: list[float] = list(b.mass_kg) if isinstance(b.mass_kg, list) else [b.mass_kg] * len(cells)
        if len(mass) != len(cells) or sum(mass) <= 0:
            allowed = f"{len(cells)} numbers >= 0, one a block, bottom row first, left to right, with a sum > 0"
            raise InvalidValueError("blocks.mass_kg", mass, allowed)
        return block_object(
            self.name,
            cells,
            size=b.size_m,
            height=b.height_m,
            mass=mass,
            friction=friction,
            friction_group=groups,
            grid=grid,
        )


def load_object(name_or_path: str | Path, grid: int = 3) -> ObjectModel:
    """An object of the library by name, or of a TOML file by path.

    Args:
        name_or_path: "L2", or "my/object.toml".
        grid: particles along a block's side.

    Raises:
        InvalidValueError: no such object, or values out of range.
        InvalidFileError: a file that is not TOML or does not fit the schema.
    """
    path = find_file(name_or_path, asset_folder("objects"), "object")
    parsed = load_toml(path, ObjectFile)
    try:
        return parsed.build(grid)
    except InvalidValueError as error:
        raise InvalidValueError(error.field, error.given, error.allowed, file=path) from None


def object_names() -> list[str]:
    """Names of the objects in the library."""
    return library_names(asset_folder("objects"))


def load_toml(path: Path, model: type[FileModel]) -> FileModel:
    """Read a TOML file into a pydantic model.

    Raises:
        InvalidFileError: unreadable, not TOML, or not fitting; the message has a line for each error.
    """
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InvalidFileError(f"{path}: cannot be read as TOML: {error}") from None
    try:
        return model.model_validate(data)
    except ValidationError as error:
        lines = [f"{path}: {_explain(dict(item))}" for item in error.errors() if not _wrong_branch(dict(item))]
        raise InvalidFileError("\n".join(dict.fromkeys(lines))) from None


_BRANCHES = ("float", "constrained-float", "str", "int")
"""Names that pydantic gives to the scalar side of "a number or a list"."""


def _wrong_branch(item: dict[str, Any]) -> bool:
    """Whether an error only says that a scalar is no list, or a list no scalar, where a field takes either."""
    branch = next((str(p) for p in item["loc"] if str(p) in _BRANCHES or "[" in str(p)), None)
    return branch is not None and (
        (item["type"] == "list_type" and not isinstance(item["input"], list))
        or (branch in _BRANCHES and isinstance(item["input"], list))
    )


def _explain(item: dict[str, Any]) -> str:
    """One error in the words of the file: field, what was given, what is allowed."""
    field = ".".join(str(p) for p in item["loc"] if str(p) not in _BRANCHES and "[" not in str(p)) or "file"
    cause = (item.get("ctx") or {}).get("error")
    if isinstance(cause, InvalidValueError):
        name = f"{field}.{cause.field}".removeprefix("file.") if cause.field not in field else field
        return f"{name}: got {cause.given!r}; allowed: {cause.allowed}"
    if item["type"] == "missing":
        return f"{field}: missing"
    if item["type"] == "extra_forbidden":
        return f"{field}: no such field; got {item['input']!r}"
    return f"{field}: got {item['input']!r}; allowed: {item['msg'].removeprefix('Input should be ')}"
