"""Units that a log may be in, and what they are in SI."""

from __future__ import annotations

import difflib
import math
from typing import Annotated

from pydantic import AfterValidator

from testbed.errors import InvalidValueError

_GRAVITY = 9.80665  # of the kilogram-force and the pound-force, by definition
_POUND = 0.45359237
_DEGREE = math.pi / 180
FACTORS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "angle": {"rad": 1.0, "deg": _DEGREE},
    "speed": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3},
    "turn rate": {"rad/s": 1.0, "deg/s": _DEGREE},
    "force": {"N": 1.0, "mN": 1e-3, "kN": 1e3, "kgf": _GRAVITY, "gf": _GRAVITY / 1e3, "lbf": _GRAVITY * _POUND},
    "torque": {
        "N m": 1.0,
        "mN m": 1e-3,
        "N mm": 1e-3,
        "N cm": 1e-2,
        "kgf m": _GRAVITY,
        "kgf cm": _GRAVITY / 1e2,
        "lbf in": _GRAVITY * _POUND * 0.0254,
    },
}
"""Quantity, unit, and how many of the SI unit it is."""


def factor(quantity: str, unit: str) -> float:
    """What to multiply by to be in SI.

    Raises:
        InvalidValueError: no such unit of that quantity; the message names those there are, and the nearest.
    """
    known = FACTORS[quantity]
    if unit not in known:
        folded = {name.replace(" ", "").casefold(): name for name in known}
        plain = "".join(c for c in unit if c not in " *.·").casefold()
        close = difflib.get_close_matches(plain, folded, n=1, cutoff=0.6)
        hint = f" (nearest: {folded[close[0]]})" if close else ""
        raise InvalidValueError("unit", unit, f"a unit of {quantity}: {', '.join(known)}{hint}")
    return known[unit]


def _of(quantity: str) -> AfterValidator:
    def check(unit: str) -> str:
        factor(quantity, unit)
        return unit

    return AfterValidator(check)


TimeUnit = Annotated[str, _of("time")]
LengthUnit = Annotated[str, _of("length")]
AngleUnit = Annotated[str, _of("angle")]
SpeedUnit = Annotated[str, _of("speed")]
TurnRateUnit = Annotated[str, _of("turn rate")]
ForceUnit = Annotated[str, _of("force")]
TorqueUnit = Annotated[str, _of("torque")]
