"""Dimensions of the parallel gripper, a Robotiq 2F-85."""

STROKE = 0.085
"""Opening [m]."""
PAD_WIDTH = 0.022
"""Width of the pads [m]."""
PAD_HEIGHT = (0.003, 0.040)
"""Lower and upper edge of the pads over the table while they hold [m]."""
FINGER_DEPTH = 0.008
"""Thickness of a finger along the closing direction at its pads [m]."""
