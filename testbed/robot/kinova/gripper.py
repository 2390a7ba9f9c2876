"""The Robotiq 2F-85 at a Gen3's interface, over Kortex."""

from __future__ import annotations

import time

from testbed.objects.model import STROKE
from testbed.robot.interfaces import ArmRefusedError
from testbed.robot.kinova.arm import KortexArm
from testbed.robot.robotiq.gripper import data_sheet

_GRIP_TIME, _STILL = 5.0, 0.3
_STEP = 1 / 255
"""Resolution of the fingers' position."""
_WIDTH_ERROR = 0.006
"""Error of an opening [m]: the fingers' position is not quite proportional to it."""


class KortexGripper:
    """A `Gripper` on a `KortexArm`. Kortex commands the position of its fingers, not their force."""

    data_sheet = staticmethod(data_sheet)

    def __init__(self, arm: KortexArm):
        self._arm = arm

    def width(self) -> float:
        """Opening between the pads [m], taken as proportional to the fingers' position."""
        return STROKE * (1 - self._arm.closed_part())

    def close_on(self, width: float, force: float) -> None:
        """Close until something stops the fingers. `force` [N] is not commanded: Kortex has no such command."""
        self._go(1.0)
        if (found := self.width()) < width - _WIDTH_ERROR:
            raise ArmRefusedError(f"gripper: closed to {found * 1e3:.0f} mm; expected {width * 1e3:.0f} mm: on nothing")

    def open(self, width: float | None) -> None:
        """Open until the pads are `width` [m] apart, None as far as they go."""
        self._go(0.0 if width is None else max(1 - width / STROKE, 0.0))

    def _go(self, part: float) -> None:
        """Send the fingers to a part of their stroke, and wait until they stand."""
        self._arm.ask("grip", position=part)
        begin = still_since = time.monotonic()
        last = self._arm.closed_part()
        while (now := time.monotonic()) - begin < _GRIP_TIME:
            time.sleep(0.02)
            here = self._arm.closed_part()
            if abs(here - last) > 1.5 * _STEP:
                last, still_since = here, now
            elif now - still_since > _STILL:
                return
        raise ArmRefusedError(f"gripper: still moving after {_GRIP_TIME:g} s")
