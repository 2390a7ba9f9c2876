"""Misfit by cause and by trial, in one figure."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from estimators.particles.misfit import CAUSES, Misfit
from viz.style import ESTIMATE, STYLE, TRUTH, bare

MOST_SHOWN = 10
"""Causes in the figure."""


@mpl.rc_context(STYLE)
def misfit_figure(misfit: Misfit, trials: Sequence[str], title: str) -> Figure:
    """What each cause would explain alone, likeliest above, beside the misfit of every trial.

    Args:
        misfit: misfit with its causes.
        trials: name of each trial.
        title: name of the experiment.
    """
    causes = list(misfit.explained.items())[:MOST_SHOWN]
    rows = max(len(causes), len(misfit.trials))
    figure = Figure(figsize=(8.0, 0.26 * rows + 1.3), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    places = np.arange(len(causes))
    left.barh(places, [100 * cause.part for _, cause in causes], color=ESTIMATE)
    left.set_yticks(
        places, [f"{name.replace('_', ' ')}, {CAUSES[name].formatted(cause.size)}" for name, cause in causes]
    )
    left.set_xlim(0.0, 100.0)
    left.set_xlabel("would explain alone, %")
    shown = sorted(misfit.trials)
    places = np.arange(len(shown))
    right.barh(places, [misfit.trials[k] for k in shown], color=TRUTH)
    right.axvline(1.0, color="black", linewidth=0.8)
    right.set_yticks(places, [trials[k].partition(" about")[0] for k in shown])
    right.set_xlabel("misfit of the trial")
    for axis in (left, right):
        axis.invert_yaxis()
        bare(axis)
    figure.suptitle(f"{title}: misfit {misfit.value:.2g}", fontsize=9)
    return figure
