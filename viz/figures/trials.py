"""Trials of one object: its actions from above, and the joint angles of its links over time."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from viz.figures.actions import draw_actions
from viz.style import STYLE, action_colors, bare
from viz.trials import TrialsView

SCALE = 22.0
"""Largest scale of the map [inches/m]."""
WIDTH, HEIGHT = (3.2, 6.5), (1.2, 4.5)
"""Least and largest size of the map [inches]."""
ANGLES = 1.1
"""Height of the panel of a hinge's joint angles [inches]."""


@mpl.rc_context(STYLE)
def trials_figure(view: TrialsView) -> Figure:
    """Object with the actions of all trials, numbered and colored in order, and the angle of each hinge below."""
    low, high = view.bounds
    scale = min(SCALE, *(np.array([WIDTH[1], HEIGHT[1]]) / (high - low)))
    width, height = np.maximum(scale * (high - low), [WIDTH[0], HEIGHT[0]])
    chain = view.shape.chain
    below = [ANGLES] * len(chain.hinges) if chain is not None and view.cameras else []
    figure = Figure(figsize=(width, height + sum(below) + 0.5), layout="constrained")
    top, *panels = figure.subplots(1 + len(below), 1, height_ratios=[height, *below], squeeze=False).ravel()
    draw_actions(top, view, view.contacts)
    top.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    for hinge, axis in enumerate(panels):
        _draw_angle(axis, view, hinge)
        axis.set_xlabel("time, s" if axis is panels[-1] else "")
    return figure


def _draw_angle(axis: Axes, view: TrialsView, hinge: int) -> None:
    """Draw a hinge's joint angle: a line per trial, in its color, with its number at the end."""
    colors = action_colors(len(view.actions))
    for number, camera in view.cameras.items():
        time, angle = camera.time_s, np.degrees(camera.joint_angles[:, hinge])
        axis.plot(time, angle, color=colors[number - 1], linewidth=1.0, gid=f"joint_{number}_{hinge}")
        if len(measured := np.flatnonzero(~np.isnan(angle))):
            x, y = float(time[measured[-1]]), float(angle[measured[-1]])
            axis.text(x, y, f" {number}", fontsize=7, va="center")
    axis.set_ylabel(f"hinge {hinge}, deg", fontsize=8)
    bare(axis)
