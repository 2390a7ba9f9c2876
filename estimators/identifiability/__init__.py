"""Identifiability: what trials show of masses and frictions, before or after they are made, and with which errors."""

from estimators.identifiability.information import Assumptions, expected, observed, predicted_information
from estimators.identifiability.posterior import Likelihood, Posterior, friction_profile, sample_posterior
from estimators.identifiability.report import Identifiability, identifiability

__all__ = [
    "Assumptions",
    "Identifiability",
    "Likelihood",
    "Posterior",
    "expected",
    "friction_profile",
    "identifiability",
    "observed",
    "predicted_information",
    "sample_posterior",
]
