"""Without Gymnasium the environment says what to install."""

import sys
from importlib import import_module

import pytest

from testbed.errors import HeftError


def test_without_gymnasium_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    monkeypatch.delitem(sys.modules, "scenarios.environment", raising=False)
    with pytest.raises(HeftError, match=r"heft-testbed\[gym\]"):
        import_module("scenarios.environment")
