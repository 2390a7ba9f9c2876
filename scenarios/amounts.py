"""Amounts as they are typed: "5%" and "60s"."""

from __future__ import annotations

from testbed.errors import InvalidValueError


def percent(text: str | None, name: str) -> float | None:
    """ "5%" or "0.05" as a part of 1; None stays None.

    Raises:
        InvalidValueError: not a part between 0 and 1.
    """
    if text is None:
        return None
    whole = text.strip().endswith("%")
    value = _number(text.strip().removesuffix("%"), name, text, "a percentage such as 5%") / (100 if whole else 1)
    if not 0 < value < 1:
        raise InvalidValueError(name, text, "a percentage above 0% and below 100%, such as 5%")
    return value


def seconds(text: str | None, name: str) -> float | None:
    """ "60s", "60" or "2min" in seconds; None stays None.

    Raises:
        InvalidValueError: not a time above 0.
    """
    if text is None:
        return None
    bare, unit = text.strip(), 1.0
    for suffix, size in (("min", 60.0), ("s", 1.0)):
        if bare.endswith(suffix):
            bare, unit = bare.removesuffix(suffix), size
            break
    value = unit * _number(bare, name, text, "a time such as 60s or 2min")
    if not 0 < value < float("inf"):
        raise InvalidValueError(name, text, "a time above 0, such as 60s or 2min")
    return value


def _number(bare: str, name: str, text: str, allowed: str) -> float:
    try:
        return float(bare)
    except ValueError:
        raise InvalidValueError(name, text, allowed) from None
