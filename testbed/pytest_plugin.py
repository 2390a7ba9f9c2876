"""pytest plugin of the conformance kit; a user's own package `estimators` may hide the kit."""

from __future__ import annotations

import pytest

from testbed.packages import hidden_package

_HIDDEN = hidden_package()
pytest_plugins = [] if _HIDDEN else ["estimators.testing.plugin"]


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the kit's option if the kit is hidden, so that its use is refused with a reason."""
    if _HIDDEN:
        parser.addoption("--estimator", help=f"not there: {_HIDDEN}")


def pytest_configure(config: pytest.Config) -> None:
    """Refuse the option of a hidden kit."""
    if _HIDDEN and config.getoption("--estimator"):
        raise pytest.UsageError(f"--estimator: {_HIDDEN}")
