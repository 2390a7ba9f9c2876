"""Weighing on a scale."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from testbed.actions.base import Action, ActionWords
from testbed.objects.model import ObjectShape


@dataclass(frozen=True)
class Weigh(Action, kind="weigh"):
    """Put the object on a scale and read its mass M."""

    moves: ClassVar[bool] = False
    grasp: ClassVar[None] = None  # pyright: ignore[reportIncompatibleVariableOverride]  no field of a weighing

    def words(self, shape: ObjectShape) -> ActionWords:
        """The parts of `describe`."""
        return ActionWords("weigh")
