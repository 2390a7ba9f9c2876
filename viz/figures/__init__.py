"""Figures for papers, drawn by matplotlib."""

from viz.figures.bars import estimate_bars
from viz.figures.loss import estimate_losses, loss_figure
from viz.figures.maps import absolute_difference, error_figure, estimate_maps, save_figure
from viz.figures.nad import nad_distribution, nad_sweep
from viz.figures.plan import plan_figure
from viz.figures.wrench import wrench_fit_figure

__all__ = [
    "absolute_difference",
    "error_figure",
    "estimate_bars",
    "estimate_losses",
    "estimate_maps",
    "loss_figure",
    "nad_distribution",
    "nad_sweep",
    "plan_figure",
    "save_figure",
    "wrench_fit_figure",
]
