"""Identifiability: what trials show of masses and frictions, before or after they are made, and with which errors.

All but the report load torch on first use, so that `estimators.base` is light.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from estimators.identifiability.report import Identifiability, identifiability

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
_POSTERIOR = ("Likelihood", "Posterior", "friction_profile", "sample_posterior")


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = "posterior" if name in _POSTERIOR else "information"
    return getattr(import_module(f"{__name__}.{module}"), name)
