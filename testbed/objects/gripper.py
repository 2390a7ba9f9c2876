"""The parallel gripper's figures that decide what it can take: the Robotiq 2F-85."""

STROKE = 0.085
"""Its opening, m."""
PAD_WIDTH = 0.022
"""Width of its pads, m."""
PAD_HEIGHT = (0.003, 0.040)
"""Lower and upper edge of the pads over the table while they hold, m."""
FINGER_DEPTH = 0.008
"""Thickness of a finger along the closing direction where its pads are, m."""
