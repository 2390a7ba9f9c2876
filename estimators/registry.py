"""Estimation methods by name: heft's own, installed ones, and "package:Class"."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from estimators.base import ActionPolicy, Estimator
from estimators.baselines.diff_lcp import DiffLcp
from estimators.baselines.explicit_state import ExplicitState
from estimators.baselines.mujoco_sysid import MujocoSysid
from estimators.baselines.optimizers import CmaEs, LeastSquares, NelderMead
from estimators.baselines.sampling import RandomSearch, WeightedSampling
from estimators.hidden_states.estimator import HiddenStates
from estimators.hidden_states.published import PublishedHiddenStates
from estimators.learned.estimator import Learned
from estimators.posterior.estimator import Bayes
from estimators.support_models.estimator import SupportAware
from testbed.plugins import Role, check_name, configured, find_class, installed, source_hash

ESTIMATOR: Role[Estimator] = Role(
    "estimators.base.Estimator",
    ("estimate(self, shape, weight, trajectories, seed)",),
    "heft.estimators",
    "my_estimator:LeastSquares",
)
POLICY: Role[ActionPolicy] = Role(
    "estimators.base.ActionPolicy", ("next(self, shape, trajectories)",), "heft.policies", "my_policy:FarthestFirst"
)

METHODS: dict[str, type[Estimator]] = {
    "hidden_states": HiddenStates,
    "hidden_states_published": PublishedHiddenStates,
    "bayes": Bayes,
    "support_aware": SupportAware,
    "random_search": RandomSearch,
    "weighted_sampling": WeightedSampling,
    "explicit_state": ExplicitState,
    "diff_lcp": DiffLcp,
    "cma_es": CmaEs,
    "nelder_mead": NelderMead,
    "least_squares": LeastSquares,
    "mujoco_sysid": MujocoSysid,
    "learned": Learned,
}
"""heft's own methods by name; their settings are the fields of the class."""

OR_LABEL = "package:Class, or any label with a method of these"


def kind_of(label: str, settings: Mapping[str, Any]) -> str:
    """Name of the method of a label: its setting `method`, or the label itself."""
    return str(settings.get("method", label))


def is_method(name: str) -> bool:
    """True for the name of a method: heft's own, an installed one, or "package:Class"."""
    return name in METHODS or ":" in name or name in installed(ESTIMATOR)


def check_method(label: str, settings: Mapping[str, Any]) -> None:
    """Check the method of a label with its settings; of another package's, the name alone: nothing is imported.

    Raises:
        InvalidValueError: unknown method, or an unknown setting or a value out of range of heft's own.
    """
    if (name := kind_of(label, settings)) in METHODS:
        build_method(label, settings)
    else:
        check_name(name, ESTIMATOR, "methods", METHODS, OR_LABEL)


def build_method(label: str, settings: Mapping[str, Any]) -> Estimator:
    """Build the method of a label with its settings.

    Raises:
        InvalidValueError: unknown method or setting, or a value out of range.
    """
    kind = class_of(kind_of(label, settings))
    own = {key: value for key, value in settings.items() if key != "method"}
    return configured(kind, own, f"methods.{label}", ("method",))


def estimates_many(label: str, settings: Mapping[str, Any]) -> bool:
    """True for a method that takes many draws at once, a `BatchEstimator` of `estimators.base`."""
    return callable(getattr(class_of(kind_of(label, settings)), "estimate_many", None))


def check_installed(label: str, settings: Mapping[str, Any]) -> None:
    """Call a method's own `check_installed`, where it has one.

    Raises:
        HeftError: the method lacks a package; the message says how to install it.
    """
    check = getattr(build_method(label, settings), "check_installed", None)
    if check is not None:
        check()


def code_of(label: str, settings: Mapping[str, Any]) -> dict[str, str]:
    """Code and files that determine a method's answers, besides settings and version: the source hash of a method of
    another package, and the `fingerprint` of a file that the method reads."""
    name = kind_of(label, settings)
    found = {} if name in METHODS else {"source": source_hash(class_of(name))}
    if name in METHODS and hasattr(METHODS[name], "fingerprint"):
        found["file"] = build_method(label, settings).fingerprint()  # pyright: ignore[reportAttributeAccessIssue]
    return found


def class_of(name: str, field: str = "methods", also: str = OR_LABEL) -> type[Estimator]:
    """Class of a method: heft's own, an installed one, or "package:Class".

    Args:
        name: name of the method.
        field: what to call it in an error.
        also: what else is allowed, for the error.

    Raises:
        InvalidValueError: unknown method.
    """
    return METHODS[name] if name in METHODS else find_class(name, ESTIMATOR, field, METHODS, also)
