"""The Robotiq 2F-85: its data sheet, as in `assets/mjcf/gripper_2f85.xml`, and its driver at a Gen3's interface."""

from __future__ import annotations

import time

import numpy as np

from testbed.objects.model import STROKE
from testbed.robot.interfaces import ArmRefusedError
from testbed.robot.kinova.arm import KortexArm
from testbed.trajectory import Tool

_GRIP_TIME, _STILL = 5.0, 0.3
_STEP = 1 / 255
"""Resolution of the fingers' position."""
_WIDTH_ERROR = 0.006
"""Allowed error of an opening [m], which is only roughly proportional to the fingers' position."""
BASE_MASS, FINGER_MASS = 0.805, 0.06
"""Masses of the base and of each finger [kg]; the published 0.925 kg split so that the center lies at 0.060 m."""
BASE_HEIGHT, FINGER_HEIGHT, TCP_HEIGHT = 0.049565, 0.13, 0.174
"""Distances from the mounting face of the base's and the fingers' centers and of the TCP [m]."""
BASE_INERTIA, FINGER_INERTIA = np.array([1.3e-3, 1.1e-3, 6e-4]), np.array([4e-5, 4e-5, 1e-5])
"""Principal inertias about their own centers [kg m^2], gripper axes, shape (3,)."""


def data_sheet(width: float) -> Tool:
    """The gripper with its pads `width` [m] apart, sensor frame: z the approach axis, the pads closing along x."""
    mass = BASE_MASS + 2 * FINGER_MASS
    center = (BASE_MASS * BASE_HEIGHT + 2 * FINGER_MASS * FINGER_HEIGHT) / mass
    along = BASE_MASS * (BASE_HEIGHT - center) ** 2 + 2 * FINGER_MASS * (FINGER_HEIGHT - center) ** 2
    across = 2 * FINGER_MASS * (width / 2) ** 2
    inertia = BASE_INERTIA + 2 * FINGER_INERTIA + [along, along + across, across]
    return Tool(mass, np.array([0.0, 0.0, center]), np.diag(inertia), np.array([0.0, 0.0, TCP_HEIGHT]))


class KortexGripper:
    """A `Gripper` on a `KortexArm`. Kortex commands the position of its fingers, not their force."""

    data_sheet = staticmethod(data_sheet)

    def __init__(self, arm: KortexArm):
        self._arm = arm

    def width(self) -> float:
        """Opening between the pads [m], taken as proportional to the fingers' position."""
        return STROKE * (1 - self._arm.closed_part())

    def close_on(self, width: float, force: float) -> None:
        """Close until an object stops the fingers. `force` [N] is ignored, since Kortex has no such command."""
        self._go(1.0)
        self._check("closed", width, "on nothing", "it does not close, or holds something else")

    def open(self, width: float | None) -> None:
        """Open until the pads are `width` [m] apart, None for the full stroke."""
        wanted = STROKE if width is None else min(width, STROKE)
        self._go(1 - wanted / STROKE)
        self._check("opened", wanted, "it does not open", "it does not close so far")

    def _check(self, moved: str, width: float, too_narrow: str, too_wide: str) -> None:
        """Raise ArmRefusedError unless the pads are `width` [m] apart; the reason depends on the sign of the error."""
        off = self.width() - width
        if abs(off) > _WIDTH_ERROR:
            raise ArmRefusedError(
                f"gripper: {moved} to {(width + off) * 1e3:.0f} mm; expected {width * 1e3:.0f} mm: "
                f"{too_narrow if off < 0 else too_wide}"
            )

    def _go(self, part: float) -> None:
        """Move the fingers to a closed fraction of their stroke, and wait until they are at rest."""
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
