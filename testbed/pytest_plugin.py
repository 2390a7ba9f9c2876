"""pytest's way to the conformance kit. A user's own `estimators` may hide it: then the user's tests run without it."""

from __future__ import annotations

import pytest

from testbed.packages import hidden_package

_HIDDEN = hidden_package()
pytest_plugins = [] if _HIDDEN else ["estimators.testing.plugin"]


def pytest_addoption(parser: pytest.Parser) -> None:
    """Take the kit's option where there is no kit, to say why."""
    if _HIDDEN:
        parser.addoption("--estimator", help=f"not there: {_HIDDEN}")


def pytest_configure(config: pytest.Config) -> None:
    """Refuse to look for a kit that is hidden."""
    if _HIDDEN and config.getoption("--estimator"):
        raise pytest.UsageError(f"--estimator: {_HIDDEN}")
