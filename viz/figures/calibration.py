"""Residuals of a calibration: reading minus model at each pose."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from testbed.robot.calibration.static_poses import Calibration, StaticPose, residuals
from viz.style import ESTIMATE, STYLE, bare

AXES = ("f_x, N", "f_y, N", "f_z, N", "t_x, N m", "t_y, N m", "t_z, N m")


@mpl.rc_context(STYLE)
def calibration_figure(calibration: Calibration, poses: Sequence[StaticPose]) -> Figure:
    """Reading minus model at each pose with its standard error, one panel per axis of the sensor."""
    figure = Figure(figsize=(8.0, 4.2), layout="constrained")
    residual, number = residuals(calibration, poses), np.arange(1, len(poses) + 1)
    error = np.array([pose.standard_error for pose in poses])
    for place, (axis, name) in enumerate(zip(figure.subplots(2, 3, sharex=True).flat, AXES, strict=True)):
        axis.axhline(0.0, color="black", linewidth=0.8)
        axis.errorbar(
            number, residual[:, place], error[:, place], color=ESTIMATE, marker="o", markersize=3, linestyle="none"
        )
        axis.set_ylabel(name)
        bare(axis)
        if place >= 3:
            axis.set_xlabel("pose")
    figure.suptitle(f"reading minus model, misfit {calibration.misfit:.2g}", fontsize=9)
    return figure
