"""Observation of a planning environment: knowledge of a policy as arrays of fixed sizes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from jaxtyping import Float

from estimators.action_selection.box import SIZE, ActionBox
from estimators.action_selection.design import Belief

MOST_GROUPS, MOST_GRASPS, MOST_DONE = 8, 16, 20
"""Rows for mass groups and grasps, more for a given object that has more, and for the latest actions."""
DECADES = 6.0
"""Decades of errors below 1: an error of 1e-6 is -1 in the observation."""
MOST_KG = 100.0
"""Greatest weight [kg]."""


def observation_space(groups: int, grasps: int) -> spaces.Dict:
    """Space of `observation`, with rows for `groups` mass groups and `grasps` grasps."""
    one = {"group_mask": (groups,), "grasp_mask": (grasps,), "mean": (groups,), "time_left": (1,)}
    signed = {
        "groups": (groups, 7),
        "grasps": (grasps, 4),
        "error": (groups,),
        "correlation": (groups, groups),
        "expected_nad": (1,),
        "done": (MOST_DONE, SIZE + 1),
    }
    boxes: dict[str, spaces.Space[Any]] = {name: spaces.Box(0.0, 1.0, size, np.float32) for name, size in one.items()}
    boxes |= {name: spaces.Box(-1.0, 1.0, size, np.float32) for name, size in signed.items()}
    boxes["scale"] = spaces.Box(0.0, MOST_KG, (2,), np.float32)
    return spaces.Dict(boxes)


def observation(
    space: spaces.Dict,
    box: ActionBox,
    belief: Belief,
    mean: Float[np.ndarray, "n_m"],
    time_left: float,
    done: Sequence[Float[np.ndarray, "7"]],
) -> dict[str, np.ndarray]:
    """Observation, zero where there is no group, grasp or action.

    Args:
        space: its space.
        box: shape, grasps and unit of length.
        belief: errors of the masses.
        mean: mass of each group as a part of M.
        time_left: fraction of the robot time that is left.
        done: points of the actions so far, each with 1 for one that went well, else -1.
    """
    shape, unit = box.shape, box.reach
    deviation = belief.standard_error / belief.weight
    covariance = belief.covariance().mean(axis=0) / belief.weight**2
    values = {
        "group_mask": np.ones(shape.n_m),
        "groups": np.array([_group(box, group) for group in range(shape.n_m)]),
        "grasp_mask": np.ones(len(box.grasps)),
        "grasps": np.array([_grasp(box, grasp) for grasp in box.grasps]),
        "mean": mean,
        "error": np.log10(np.maximum(deviation, 1e-12)) / DECADES,
        "correlation": covariance / np.outer(deviation, deviation),
        "expected_nad": np.log10([belief.expected_nad]) / DECADES,
        "time_left": np.array([time_left]),
        "scale": np.array([belief.weight, unit]),
        "done": np.reshape(done[: -MOST_DONE - 1 : -1], (-1, SIZE + 1)),
    }
    found = {}
    for name, each in space.items():
        assert isinstance(each, spaces.Box)
        found[name] = np.zeros(each.shape, dtype=np.float32)
        found[name][tuple(slice(length) for length in values[name].shape)] = values[name]
        found[name] = found[name].clip(each.low, each.high)
    return found


def _group(box: ActionBox, group: int) -> tuple[float, ...]:
    """Center, second moments xx, xy, yy about it, part of the object's area, and part of it that touches the table."""
    shape, cells = box.shape, box.shape.cells_of(group)
    x, y = (shape.middle_of(group) / box.reach).tolist()
    off = (shape.particles[cells] - shape.middle_of(group)) / box.reach
    (xx, xy), (_, yy) = off.T @ off / len(off)
    touching = shape.friction_group[shape.mass_group == group] >= 0
    return x, y, xx, xy, yy, len(cells) / len(shape.cells), float(touching.mean())


def _grasp(box: ActionBox, grasp: int) -> tuple[float, ...]:
    """Position, and cosine and sine of twice the closing angle: both senses are equal."""
    place = box.shape.grasps[grasp]
    return (*(place.position / box.reach).tolist(), float(np.cos(2 * place.angle)), float(np.sin(2 * place.angle)))
