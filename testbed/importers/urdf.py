"""Forward kinematics of an arm from its URDF."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from testbed.errors import InvalidValueError
from testbed.importers.logs import LogError, unknown

_KINDS = ("revolute", "continuous", "prismatic", "fixed")


class Joint(NamedTuple):
    """Joint of a URDF."""

    name: str
    kind: str
    """Type in the URDF."""
    position: np.ndarray
    """Origin in the parent link [m]."""
    rotation: Rotation
    axis: np.ndarray
    """Unit vector."""
    parent: str
    """Name of the parent link."""


def joints_to(path: Path, link: str, base: str | None = None) -> list[Joint]:
    """Joints of a URDF from a base to a link, in this order.

    Args:
        path: the file; its meshes and masses do not matter.
        link: name of the last link.
        base: name of the first one; None is the root.

    Raises:
        InvalidValueError: no such link, or a joint of a kind that has no angle.
        LogError: a file that is no URDF, or whose links form a cycle.
    """
    try:
        robot = ElementTree.parse(path).getroot()
        joints = {str(_part(j, "child").get("link")): _joint(j) for j in robot.findall("joint")}
    except (OSError, ValueError, ElementTree.ParseError) as error:
        raise LogError(f"{path}: not a URDF: {error}") from None
    if link not in joints:
        raise unknown("hand.frame", link, list(joints), path)
    chain, above = [], link
    while above in joints and above != base and len(chain) <= len(joints):
        chain.append(joints[above])
        above = joints[above].parent
    if len(chain) > len(joints):
        raise LogError(f"{path}: a cycle of links above {link}; allowed: a tree, of one root")
    if base not in (None, above):
        raise InvalidValueError("hand.base", base, f"a link above {link}, or {above}", file=path)
    if wrong := [j for j in chain if j.kind not in _KINDS]:
        raise InvalidValueError(f"joint {wrong[0].name}", wrong[0].kind, f"one of {', '.join(_KINDS)}", file=path)
    return chain[::-1]


def forward_kinematics(
    joints: Sequence[Joint], values: Float[np.ndarray, "N K"]
) -> tuple[Float[np.ndarray, "N 3"], Rotation]:
    """Position [m] and orientation of the last link in the first.

    Args:
        joints: the chain from base to link.
        values: angles [rad] or ways [m] of those that move, in their order.
    """
    moving = iter(values.T[::-1])
    position, rotation = np.zeros((len(values), 3)), Rotation.identity(len(values))
    for joint in reversed(joints):
        if joint.kind == "prismatic":
            position = position + np.outer(next(moving), joint.axis)
        elif joint.kind != "fixed":
            turn = Rotation.from_rotvec(np.outer(next(moving), joint.axis))
            position, rotation = turn.apply(position), turn * rotation
        position, rotation = joint.rotation.apply(position) + joint.position, joint.rotation * rotation
    return position, rotation


def _joint(element: ElementTree.Element) -> Joint:
    origin, axis = element.find("origin"), element.find("axis")
    xyz, rpy = (_three(origin.get(n, "0 0 0") if origin is not None else "0 0 0") for n in ("xyz", "rpy"))
    along = _three(axis.get("xyz", "1 0 0") if axis is not None else "1 0 0")
    parent = str(_part(element, "parent").get("link"))
    unit = along / max(float(np.linalg.norm(along)), 1e-12)
    return Joint(element.get("name", ""), element.get("type", ""), xyz, Rotation.from_euler("xyz", rpy), unit, parent)


def _part(element: ElementTree.Element, name: str) -> ElementTree.Element:
    found = element.find(name)
    if found is None:
        raise ValueError(f"joint {element.get('name')} has no {name}")
    return found


def _three(text: str) -> np.ndarray:
    numbers = np.array([float(part) for part in text.split()])
    if numbers.shape != (3,) or not np.isfinite(numbers).all():
        raise ValueError(f"got {text!r}; allowed: three numbers")
    return numbers
