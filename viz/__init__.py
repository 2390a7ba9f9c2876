"""Figures, recordings and reports of trials and estimates; they draw values and read no results folder.

The names below load their module on first use: `import viz` by itself costs nothing.
"""

from typing import TYPE_CHECKING

from testbed.packages import lazy_names

if TYPE_CHECKING:
    from viz.figures.bars import estimate_bars
    from viz.figures.maps import estimate_maps, save_figure
    from viz.recordings.page import Page, save, send
    from viz.values import EstimateView, TrialView, WrenchFit


__all__ = [
    "EstimateView",
    "Page",
    "TrialView",
    "WrenchFit",
    "estimate_bars",
    "estimate_maps",
    "save",
    "save_figure",
    "send",
]

__getattr__, __dir__ = lazy_names(__name__)
