"""Identifiability: what trials show of masses and frictions, before or after they are made, and with which errors.

All but the report load torch on first use, so that `estimators.base` is light.
"""

from typing import TYPE_CHECKING

from estimators.identifiability.report import Identifiability, identifiability
from testbed.packages import lazy_names

if TYPE_CHECKING:
    from estimators.identifiability.information import Assumptions, expected, observed, predicted_information
    from estimators.identifiability.posterior import Likelihood, Posterior, friction_profile, sample_posterior

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

__getattr__, __dir__ = lazy_names(__name__)
