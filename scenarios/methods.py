"""Methods by name, and how a scenario's settings become one."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from estimators.diff_lcp import DiffLcp
from estimators.explicit_state import ExplicitState
from estimators.hidden_states import HiddenStatesEstimator
from estimators.protocol import Estimator
from estimators.random_search import RandomSearch
from estimators.support_aware import SupportAware
from estimators.weighted_sampling import WeightedSampling
from testbed.errors import InvalidValueError

METHODS: dict[str, type[Estimator]] = {
    "hidden_states": HiddenStatesEstimator,
    "support_aware": SupportAware,
    "random_search": RandomSearch,
    "weighted_sampling": WeightedSampling,
    "explicit_state": ExplicitState,
    "diff_lcp": DiffLcp,
}
"""Methods by name; their settings are the fields of the class."""


def kind_of(label: str, settings: Mapping[str, Any]) -> str:
    """Which method a label stands for: the setting `method`, or the label itself."""
    return str(settings.get("method", label))


def build_method(label: str, settings: Mapping[str, Any]) -> Estimator:
    """A method with its settings.

    Raises:
        InvalidValueError: unknown method or setting, or a value out of range.
    """
    name = kind_of(label, settings)
    if name not in METHODS:
        allowed = f"one of {', '.join(METHODS)}{nearest(name, METHODS)}, or any label with a method of these"
        raise InvalidValueError("methods", name, allowed)
    given = {key: value for key, value in settings.items() if key != "method"}
    known = [f.name for f in fields(METHODS[name])]  # pyright: ignore[reportArgumentType]
    if unknown := sorted(set(given) - set(known)):
        allowed = f"settings method, {', '.join(known)}{nearest(unknown[0], known)}"
        raise InvalidValueError(f"methods.{label}", ", ".join(unknown), allowed)
    try:
        return METHODS[name](**{key: tuple(v) if isinstance(v, list) else v for key, v in given.items()})
    except TypeError as error:  # a table where a number belongs
        raise InvalidValueError(f"methods.{label}", given, f"values of the settings' types ({error})") from None


def nearest(name: str, names: Mapping[str, Any] | list[str]) -> str:
    """ " (nearest: ...)" for a name that is nearly one of `names`, else nothing."""
    close = difflib.get_close_matches(name.casefold(), [*names], n=1, cutoff=0.5)
    return f" (nearest: {close[0]})" if close else ""
