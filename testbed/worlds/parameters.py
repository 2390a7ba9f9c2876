"""Errors of a setup as parameters: drawn by a world, stated by a lab and named by a diagnosis."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cache
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from testbed.validation import Range

FULL_SCALE = np.repeat([300.0, 30.0], 3)
"""Full scale of a wrist sensor's axes [N, N m], that of the FT-300S: cross-talk is a part of it."""
Scope = Literal["object", "setup", "trial", "sample"]
_MOST = {"": 1.0, "m": 0.1, "rad": 0.3, "s": 1.0, "kg": 1.0, "N": 10.0, "N m": 1.0}
"""Largest size of an error by its unit; a larger one is likely in mm, degrees, ms or g. Ours."""
_SHOWN = {"": (100.0, "%"), "m": (1e3, "mm"), "rad": (180 / math.pi, "deg"), "s": (1e3, "ms"), "kg": (1e3, "g")}


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One error of a setup. Its name, meaning and size are those of the field that it describes."""

    unit: str = ""
    """SI unit; empty for a ratio."""
    shape: tuple[int | str, ...] = ()
    """Shape of one draw; "groups" is the number of mass groups, "feet" that of feet of known places."""
    scope: Scope = "setup"
    """Extent of one draw: an object, the whole setup, a trial, or a sample."""
    shows: tuple[str, ...] = ()
    """Measurements of the forward model that it affects: `table`, `air`, or the `reading` of the sensor in both."""
    source: str = ""
    """Source of error in a budget; empty if no simulation draws it."""
    likely: float = 0.0
    """Standard deviation with which it is tested as the cause of a misfit if none is stated; 0: not tested."""
    cause: str = ""
    """Message if it explains a misfit: cause and remedy."""
    least: float = 0.0
    """Least value, that of an exact setup."""
    most: float | None = None
    """Greatest value; None is that of its unit."""
    shown: tuple[float, str] | None = None
    """Factor and unit in which its size is printed; None is that of its SI unit."""

    def sized(self, groups: int, feet: int = 0) -> tuple[int, ...]:
        """Shape of one draw for an object of so many mass groups, and feet of known places."""
        counts = {"groups": groups, "feet": feet}
        return tuple(counts[each] if isinstance(each, str) else each for each in self.shape)

    def check(self, field: str, value: object) -> None:
        """Raise InvalidValueError unless a value is a finite number in the range of this parameter."""
        Range(self.least, _MOST[self.unit] if self.most is None else self.most, self.unit).check(field, value)

    def formatted(self, size: float) -> str:
        """Size in words, such as "2.1 mm"."""
        factor, unit = self.shown or _SHOWN.get(self.unit, (1.0, self.unit))
        return f"{factor * size:.2g} {unit}"


def parameter(least: float = 0.0, *, default: float | None = None, **settings: Any) -> Any:
    """Field of a dataclass, described by a `Parameter` with these settings; its default is exact if left out."""
    described = Parameter(least=least, **settings)
    return field(default=least if default is None else default, metadata={"parameter": described})


@cache
def parameters_of(kind: type) -> Mapping[str, Parameter]:
    """Parameters among the fields of a dataclass, by name."""
    return MappingProxyType({f.name: f.metadata["parameter"] for f in fields(kind) if "parameter" in f.metadata})
