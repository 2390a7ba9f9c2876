"""Figures, recordings and reports of trials and estimates; they draw values and read no results folder.

The names below load their module on first use: `import viz` by itself costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from viz.figures.maps import estimate_bars, estimate_maps, save_figure
    from viz.figures.wrench import wrench_fit_figure
    from viz.recordings.page import Page, save, send
    from viz.values import EstimateView, PlanView, TrialView, WrenchFit

_MODULES = {
    "figures.maps": ("estimate_bars", "estimate_maps", "save_figure"),
    "figures.wrench": ("wrench_fit_figure",),
    "recordings.page": ("Page", "save", "send"),
    "values": ("EstimateView", "PlanView", "TrialView", "WrenchFit"),
}
_MODULE_OF = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names}

__all__ = [
    "EstimateView",
    "Page",
    "PlanView",
    "TrialView",
    "WrenchFit",
    "estimate_bars",
    "estimate_maps",
    "save",
    "save_figure",
    "send",
    "wrench_fit_figure",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULE_OF[name]), name)
