"""Identifiability: what trials show of masses and frictions, before or after they are made, and with which errors.

All but the report load torch on first use, so that `estimators.base` is light.
"""

from typing import TYPE_CHECKING

from estimators.identifiability.report import Identifiability, identifiability
from testbed.packages import lazy_names

if TYPE_CHECKING:
    from estimators.identifiability.information import Assumptions, expected, observed, predicted_information

__all__ = [
    "Assumptions",
    "Identifiability",
    "expected",
    "identifiability",
    "observed",
    "predicted_information",
]

__getattr__, __dir__ = lazy_names(__name__)
