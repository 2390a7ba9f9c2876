"""Search for the truth in what a method or a policy is given: no record of a simulated trial may hold it.

Only the arguments of a method are searched, not the files and the memory that it could read.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from enum import Enum
from typing import Any

import numpy as np

from testbed.objects.model import ObjectModel
from testbed.sensing.noise import draw_sensing
from testbed.sensing.presets import PRESETS
from testbed.trajectory import Trajectory
from testbed.worlds.draw import WorldDraw
from testbed.worlds.presets import WORLDS, World
from testbed.worlds.setup_errors import PARAMETERS

SECRET_WORDS = frozenset("seed support stiffness preset truth total friction figures state solids world draw".split())
"""Words that the name of a non-empty attribute or entry must not contain."""
ALLOWED_NAMES = frozenset(("friction_group", "wrench_on_object_world", *PARAMETERS))
"""Names of the division of the shape and of the sizes of errors, which contain no coefficient."""
SECRET_TEXTS = frozenset((*PRESETS, *WORLDS, "own_weight", "rigid")) - {"low", "high"}
"""Texts that name a sensor or a support."""
MOST_INTEGERS = 64
"""Greatest number of integers that are tried as a seed, the largest first: seeds are large."""
TOLERANCE = 1e-9
"""Distance from the true wrench within which it is rebuilt [N, N m]."""


def truth_within_reach(given: Mapping[str, Any], model: ObjectModel, clean: Sequence[Trajectory] = ()) -> list[str]:
    """Sentences on every way found from what was given to the truth; empty where there is none.

    Args:
        given: arguments of `estimate` or `next`, or of a policy's class, by name.
        model: object with its truth, to recognize what has been found.
        clean: records of a perfect sensor behind the trajectories in `given["trajectories"]`.
    """
    found = list(_reachable(given))
    names = [f"{path} is given" for path, name, value in found if _secret(name) and _is_filled(value)]
    texts = [f"{path} says {value!r}" for path, _, value in found if isinstance(value, str) and _names_secret(value)]
    secret = (ObjectModel, World, WorldDraw)
    held = [f"{path} is of {type(value).__name__}" for path, _, value in found if isinstance(value, secret)]
    values = [said for path, _, value in found for said in _true_number(path, value, model)]
    integers = sorted({n for _, _, value in found for n in _integers(value)}, reverse=True)[:MOST_INTEGERS]
    drawn_by = {draw.seed for t in clean if (draw := WorldDraw.in_record(t.provenance))}
    said = " ".join([*map(str, integers), *(value for _, _, value in found if isinstance(value, str))])
    seeds = [f"the seed {seed} of the world is given" for seed in drawn_by if str(seed) in said]
    rebuilt = [
        said
        for index, (seen, true) in enumerate(zip(given.get("trajectories", ()), clean, strict=False))
        for said in _redrawn(index, seen, true, integers)
    ]
    return [*names, *texts, *held, *values, *seeds, *rebuilt]


def _reachable(value: Any, path: str = "", name: str = "", depth: int = 12) -> Iterator[tuple[str, str, Any]]:
    """Path, name and value of everything within reach by attributes, entries and items."""
    if path:
        yield path, name, value
    if depth == 0 or isinstance(value, str | bytes | int | float | np.ndarray | Enum | type | None):
        return
    if isinstance(value, Mapping):
        parts = [(f"{path}[{key!r}]" if path else str(key), str(key) if path else "", v) for key, v in value.items()]
    elif isinstance(value, Sequence | set | frozenset):
        parts = [(f"{path}[{index}]", "", part) for index, part in enumerate(value)]
    else:
        parts = [(f"{path}.{key}", key, part) for key, part in getattr(value, "__dict__", {}).items()]
    for where, called, part in parts:
        yield from _reachable(part, where, called, depth - 1)


def _secret(name: str) -> bool:
    """True if a name may stand for the truth; the names of arguments are the protocol's."""
    return name not in ALLOWED_NAMES and not SECRET_WORDS.isdisjoint(name.split("_"))


def _is_filled(value: Any) -> bool:
    return isinstance(value, int | float) or bool(np.size(value) if isinstance(value, np.ndarray) else value)


def _names_secret(text: str) -> bool:
    """True if a text names a sensor or a support, alone or with something after it."""
    return text.partition(":")[0] in SECRET_TEXTS


def _true_number(path: str, value: Any, model: ObjectModel) -> Iterator[str]:
    """A true mass, friction, weight or inertia among single numbers and short arrays, to the last digits."""
    if not isinstance(value, float | np.ndarray):
        return
    numbers = np.atleast_1d(np.asarray(value, dtype=float)).ravel()
    if numbers.size > model.shape.n_m + model.shape.n_mu:  # series and geometry may contain equal numbers by chance
        return
    # masses of whole blocks and frictions are round numbers, which equal a speed or a length by chance
    for what, true in {"mass": [*model.truth.mass, model.total_mass], "inertia": [model.inertia_cm]}.items():
        if np.isclose(numbers[:, None], np.array(true), rtol=1e-12, atol=0.0).any():
            yield f"{path} holds a true {what}"


def _integers(value: Any) -> set[int]:
    """Integers in a value: itself, those of an array, and those that a text spells."""
    if isinstance(value, str):
        return {int(digits) for digits in re.findall(r"\d+", value)[:4]}
    if isinstance(value, np.ndarray) and np.issubdtype(value.dtype, np.integer):
        return {int(n) for n in np.unique(value)[:8] if n >= 0}
    return {abs(int(value))} if isinstance(value, int | np.integer) else set()


def _redrawn(index: int, measured: Trajectory, clean: Trajectory, integers: Sequence[int]) -> Iterator[str]:
    """Integers that, as the seed of a sensor's draw, give the clean wrench after subtraction of the draw."""
    silent = replace(measured, sensor_wrench=np.zeros_like(measured.sensor_wrench), provenance={"runner": "simulation"})
    for integer in integers:
        for name, sensor in PRESETS.items():
            if name == "ideal":
                continue
            errors = draw_sensing(silent, sensor, integer).sensor_wrench
            off = float(np.abs(measured.sensor_wrench - errors - clean.sensor_wrench).max())
            if off < TOLERANCE:
                yield f"trajectories[{index}]: seed {integer} of {name} gives the clean wrench back to {off:.0e}"
