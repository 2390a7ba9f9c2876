"""Robotiq 2F-85: mass, inertia and tool center point, as in `assets/mjcf/gripper_2f85.xml`."""

from __future__ import annotations

import numpy as np

from testbed.trajectory import Tool

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
