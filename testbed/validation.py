"""Arrays inside frozen values: float64, finite, of the right shape, read-only; checked once."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from testbed.errors import InvalidValueError


def frozen_array(name: str, values: ArrayLike, shape: tuple[int | None, ...], *, finite: bool = True) -> np.ndarray:
    """A read-only float64 copy of `values`.

    Args:
        name: what to call it in an error.
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


def freeze_arrays(value: object, **shapes: tuple[int | None, ...]) -> None:
    """Replace array fields of a frozen dataclass by checked read-only copies.

    Raises:
        InvalidValueError: wrong shape, not numeric, or not finite; it names `Class.field`.
    """
    for name, shape in shapes.items():
        array = frozen_array(f"{type(value).__name__}.{name}", getattr(value, name), shape)
        object.__setattr__(value, name, array)


def unit_quaternion(name: str, values: ArrayLike) -> np.ndarray:
    """A read-only unit quaternion, wxyz, shape (4,).

    Raises:
        InvalidValueError: another shape, or a length that is not 1.
    """
    quaternion = frozen_array(name, values, (4,))
    if abs(np.linalg.norm(quaternion) - 1) > 1e-3:
        raise InvalidValueError(name, quaternion.tolist(), "a unit quaternion, wxyz")
    return quaternion


def check_positive(name: str, value: float) -> None:
    """Raise InvalidValueError unless `value` is finite and > 0."""
    if not (is_number(value) and value > 0):
        raise InvalidValueError(name, value, "a finite number > 0")


def check_positive_fields(value: object, *names: str) -> None:
    """Raise InvalidValueError unless the named fields are finite and > 0."""
    for name in names:
        check_positive(f"{type(value).__name__}.{name}", getattr(value, name))


def check_integer(name: str, value: int, least: int = 1, most: int = 1_000_000) -> None:
    """Raise InvalidValueError unless `value` is an integer from `least` to `most`, and no bool."""
    if isinstance(value, bool) or not (isinstance(value, int) and least <= value <= most):
        above = f" and <= {most}" if isinstance(value, int) and value > most else ""
        raise InvalidValueError(name, value, f"an integer >= {least}{above}")


def is_number(value: object) -> bool:
    """True for a finite real number that is no bool."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def _describe(shape: tuple[int | None, ...]) -> str:
    sizes = ", ".join("n" if size is None else str(size) for size in shape)
    return f"({sizes},)" if len(shape) == 1 else f"({sizes})"
