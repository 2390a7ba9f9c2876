"""Rerun recordings of trials, estimates, comparisons and plans, and Rerun's viewer."""

from viz.recordings.comparison import comparison_blueprint, log_comparison
from viz.recordings.estimate import estimate_blueprint, log_estimate
from viz.recordings.page import ITERATION, SIM_TIME, Page, save, send
from viz.recordings.plan import plan_page
from viz.recordings.trial import fits_blueprint, log_fits, log_trial, trial_blueprint

__all__ = [
    "ITERATION",
    "SIM_TIME",
    "Page",
    "comparison_blueprint",
    "estimate_blueprint",
    "fits_blueprint",
    "log_comparison",
    "log_estimate",
    "log_fits",
    "log_trial",
    "plan_page",
    "save",
    "send",
    "trial_blueprint",
]
