"""Diagnosis of a setup in one figure: odds of its errors, and misfits of the trials."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from estimators.posterior.diagnosis import DECISIVE, Diagnosis
from viz.style import ESTIMATE, STYLE, TRUTH, bare

MOST_SHOWN = 10
"""Largest number of causes in the figure."""


@mpl.rc_context(STYLE)
def diagnosis_figure(found: Diagnosis, trials: Sequence[str], title: str) -> Figure:
    """Odds that each error is larger than stated, most likely first, and the misfit of every trial.

    Args:
        found: diagnosis.
        trials: names of the trials.
        title: name of the experiment.
    """
    causes = found.causes[:MOST_SHOWN]
    rows = max(len(causes), len(found.trials))
    figure = Figure(figsize=(8.0, 0.26 * rows + 1.3), layout="constrained")
    *beside, right = figure.subplots(1, 1 + bool(causes), width_ratios=(3, 2)[-1 - bool(causes) :], squeeze=False)[0]
    for left in beside:
        places = np.arange(len(causes))
        left.barh(places, [cause.odds for cause in causes], color=ESTIMATE)
        left.axvline(DECISIVE, color="black", linewidth=0.8)
        left.set_yticks(places, [f"{cause.name.replace('_', ' ')}, {cause.formatted}" for cause in causes])
        left.set_xlabel("odds of being larger than stated, log10")
    shown = sorted(found.trials)
    places = np.arange(len(shown))
    right.barh(places, [found.trials[k] for k in shown], color=TRUTH)
    right.axvline(1.0, color="black", linewidth=0.8)
    right.set_yticks(places, [trials[k].partition(" about")[0] for k in shown])
    right.set_xlabel("misfit of the trial")
    for axis in (*beside, right):
        axis.invert_yaxis()
        bare(axis)
    figure.suptitle(f"{title}: misfit {found.misfit.value:.2g}", fontsize=9)
    return figure
