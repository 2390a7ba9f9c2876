"""Validation: arrays of frozen dataclasses, checked once; and ranges of settings, stated in their annotations.

A class whose arguments are settings states the range of every number among them:

    stale_after: Annotated[float, Range(0.03, 0.2, "s")] = 0.1
    gains: tuple[Annotated[float, Range(0, 10, "1/s")], ...] = (1.0, 2.0)

Heft checks the settings of a file, for its own classes and for plugins. A class that is also constructed in Python
calls `check_settings` itself.
"""

from __future__ import annotations

import inspect
import math
import sys
from collections import ChainMap
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeGuard, Union, get_args, get_origin

import numpy as np
from numpy.typing import ArrayLike
from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from testbed.errors import InvalidValueError

MOST_WEIGHT = 100.0
"""Bound of the mass that a scale reads [kg]."""


def frozen_array(name: str, values: ArrayLike, shape: tuple[int | None, ...], *, finite: bool = True) -> np.ndarray:
    """Read-only float64 copy of `values`.

    Args:
        name: field in an error.
        values: anything array-like.
        shape: expected shape; None matches any length.
        finite: refuse NaN and infinity.

    Raises:
        InvalidValueError: wrong shape, not numeric, or not finite.
    """
    try:
        given = np.asarray(values)
    except (TypeError, ValueError):
        given = None
    if given is None or given.dtype.kind not in "iuf":
        raise InvalidValueError(name, values, f"numbers of shape {_describe(shape)}")
    array = np.array(given, dtype=np.float64)
    if array.ndim != len(shape) or any(want not in (None, have) for want, have in zip(shape, array.shape, strict=True)):
        raise InvalidValueError(name, f"shape {array.shape}", f"shape {_describe(shape)}")
    if finite and not np.isfinite(array).all():
        raise InvalidValueError(name, f"{int((~np.isfinite(array)).sum())} NaN or infinite entries", "finite numbers")
    array.flags.writeable = False
    return array


class ReadOnlyArrays:
    """Base of dataclasses whose arrays stay read-only when unpickled."""

    def __setstate__(self, state: dict[str, Any]) -> None:
        for name, value in state.items():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
            object.__setattr__(self, name, value)


def freeze_arrays(value: object, **shapes: tuple[int | None, ...]) -> None:
    """Replace array fields of a frozen dataclass by checked read-only copies.

    Raises:
        InvalidValueError: wrong shape, not numeric, or not finite; it names `Class.field`.
    """
    for name, shape in shapes.items():
        array = frozen_array(f"{type(value).__name__}.{name}", getattr(value, name), shape)
        object.__setattr__(value, name, array)


def unit_quaternion(name: str, values: ArrayLike) -> np.ndarray:
    """Read-only unit quaternion, wxyz, shape (4,).

    Raises:
        InvalidValueError: another shape, or a norm that is not 1.
    """
    quaternion = frozen_array(name, values, (4,))
    if abs(np.linalg.norm(quaternion) - 1) > 1e-3:
        raise InvalidValueError(name, quaternion.tolist(), "a unit quaternion, wxyz")
    return quaternion


def check_positive(name: str, value: float) -> None:
    """Raise InvalidValueError unless `value` is finite and > 0."""
    if not (is_number(value) and value > 0):
        raise InvalidValueError(name, value, "a finite number > 0")


def check_kilograms(name: str, value: float | None) -> None:
    """Raise InvalidValueError unless `value` is > 0 and < `MOST_WEIGHT` [kg], which a mass in grams exceeds."""
    if not (is_number(value) and 0 < value < MOST_WEIGHT):
        raise InvalidValueError(name, value, f"a number > 0 and < {MOST_WEIGHT:g}, kg")


def check_positive_fields(value: object, *names: str) -> None:
    """Raise InvalidValueError unless the named fields are finite and > 0."""
    for name in names:
        check_positive(f"{type(value).__name__}.{name}", getattr(value, name))


def check_integer(name: str, value: object, least: int = 1, most: int = 1_000_000) -> int:
    """Value as an int, for an integer from `least` to `most` of Python or NumPy.

    Raises:
        InvalidValueError: another value, or a bool.
    """
    if isinstance(value, int | np.integer) and not isinstance(value, bool):
        if least <= (number := int(value)) <= most:
            return number
        above = f" and <= {most}" if number > most else ""
        raise InvalidValueError(name, value, f"an integer >= {least}{above}")
    raise InvalidValueError(name, value, f"an integer >= {least}")


def is_number(value: object) -> TypeGuard[float]:
    """True for a finite real number that is not a bool."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def _describe(shape: tuple[int | None, ...]) -> str:
    sizes = ", ".join("n" if size is None else str(size) for size in shape)
    return f"({sizes},)" if len(shape) == 1 else f"({sizes})"


@dataclass(frozen=True)
class Range:
    """Closed interval of a number; metadata of an `Annotated` type, also in a pydantic model."""

    low: float
    """Lowest value."""
    high: float
    """Highest value."""
    unit: str
    """Unit of both; empty for a pure number."""

    def __post_init__(self) -> None:
        if not (is_number(self.low) and is_number(self.high) and self.low < self.high):
            raise InvalidValueError("Range", (self.low, self.high), "two finite numbers, the lower one first")
        if not isinstance(self.unit, str):
            raise InvalidValueError("Range.unit", self.unit, 'a unit as text, such as "m/s"')

    def __str__(self) -> str:
        return f"{self.low:g} to {self.high:g} {self.unit}".rstrip()

    def check(self, field: str, value: object, kind: type = float) -> None:
        """Check a number.

        Args:
            field: field in an error.
            value: the number.
            kind: int to allow only integers.

        Raises:
            InvalidValueError: a value that is not a number, a bool, NaN, or a number outside the range.
        """
        whole = issubclass(kind, int | np.integer)
        inside = is_number(value) and self.low <= value <= self.high  # pyright: ignore[reportOperatorIssue]
        if not inside or (whole and not isinstance(value, int | np.integer)):
            raise InvalidValueError(field, value, f"{'an integer from ' if whole else ''}{self}")

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        def checked(value: object) -> object:
            self.check("", value, source)
            return value

        return core_schema.no_info_before_validator_function(checked, handler(source))


def check_settings(kind: type, values: Mapping[str, Any], field: str, skip: Collection[str] = ()) -> None:
    """Check the numbers among the settings of a class, defaults included, by the ranges in its annotations.

    Args:
        kind: the class.
        values: settings by name; for an object, `vars(self)`.
        field: field of the settings in an error.
        skip: names of arguments that are not settings.

    Raises:
        InvalidValueError: a number outside its range, or without a stated range; a value of another shape.
    """
    arguments, others = arguments_of(kind)
    extra = {} if others is None else {name: others for name in values if name not in arguments}
    for name, (annotation, default) in (arguments | extra).items():
        if name in skip and name not in values:
            continue
        value = values.get(name, default)
        if _lacks_range(annotation):
            raise _unstated(f"{field}.{name}", value)
        if value is not _MISSING:
            _check(f"{field}.{name}", annotation, value, None)


_MISSING = inspect.Parameter.empty
_LISTS = (list, tuple, Sequence)


@lru_cache
def arguments_of(kind: Callable[..., Any]) -> tuple[dict[str, tuple[Any, Any]], tuple[Any, Any] | None]:
    """Annotation and default of each argument by name, and of `**kwargs` if the class takes them."""
    bases = inspect.getmro(kind) if inspect.isclass(kind) else (kind,)
    names = ChainMap(*(vars(sys.modules[base.__module__]) for base in bases))
    found, others = {}, None
    for argument in inspect.signature(kind).parameters.values():
        annotation = argument.annotation
        if isinstance(annotation, str):
            try:
                annotation = eval(annotation, {}, names)  # as `inspect.get_annotations`, but each alone
            except Exception:  # a name that is defined for type checkers only
                annotation = Any
        if argument.kind is argument.VAR_KEYWORD:
            others = annotation, _MISSING
        elif argument.kind is not argument.VAR_POSITIONAL:
            found[argument.name] = annotation, argument.default
    return found, others


def _is_number_type(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, int | float | np.number) and annotation is not bool


def _lacks_range(annotation: Any) -> bool:
    """True if an annotation has a type of numbers without a range."""
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin is Literal or (origin is Annotated and any(isinstance(each, Range) for each in inner)):
        return False
    return _is_number_type(annotation) or any(map(_lacks_range, inner))


def _numbers(value: object) -> Iterator[object]:
    """Numbers in a value, at any depth."""
    if isinstance(value, int | float | np.number) and not isinstance(value, bool):
        yield value
    elif isinstance(value, np.ndarray) and value.dtype.kind in "iuf":
        yield from value.ravel().tolist()
    elif isinstance(value, Mapping):
        yield from _numbers(list(value.values()))
    elif isinstance(value, list | tuple | set):
        for one in value:
            yield from _numbers(one)


def _check(field: str, annotation: Any, value: Any, within: Range | None) -> None:
    """Check a value by its annotation; `within` is the range stated around it."""
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        within = next((a for a in inner[1:] if isinstance(a, Range)), within)
        _check(field, inner[0], value, within)
    elif origin in (Union, UnionType):
        _check_union(field, inner, value, within)
    elif origin is Literal:
        if not any(value == one and isinstance(value, bool) == isinstance(one, bool) for one in inner):
            raise InvalidValueError(field, value, f"one of {', '.join(map(repr, inner))}")
    elif _is_number_type(annotation) and within is not None:
        within.check(field, value, annotation)
    elif origin in _LISTS and inner:
        fixed = origin is tuple and inner[-1] is not Ellipsis
        if not isinstance(value, list | tuple | np.ndarray) or (fixed and len(value) != len(inner)):
            raise InvalidValueError(field, value, f"a list of {len(inner)} values" if fixed else "a list")
        for index, one in enumerate(value):
            _check(f"{field}[{index}]", inner[index if fixed else 0], one, within)
    else:
        for number in _numbers(value):
            if within is None:
                raise _unstated(field, value)
            within.check(field, number)


def _check_union(field: str, branches: tuple[Any, ...], value: Any, within: Range | None) -> None:
    if value is None and NoneType in branches:
        return
    refusals = []
    for branch in branches:
        if branch is NoneType:
            continue
        try:
            return _check(field, branch, value, within)
        except InvalidValueError as error:
            refusals.append(error)
    raise refusals[0]


def _unstated(field: str, value: object) -> InvalidValueError:
    name = field.rpartition(".")[2].partition("[")[0]
    return InvalidValueError(
        field,
        "no value" if value is _MISSING else value,
        "a number whose range the class states: from testbed.validation import Range, then "
        f'{name}: Annotated[float, Range(lowest, highest, "unit")]',
    )
