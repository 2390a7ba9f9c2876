"""Errors: what becomes of one between processes."""

import pickle
from pathlib import Path

import pytest

from estimators.baselines.dry_friction import LcpError
from testbed.errors import InvalidValueError


@pytest.mark.parametrize("kind", [InvalidValueError, LcpError])
@pytest.mark.parametrize("file", [None, Path("a.toml")])
def test_an_error_is_the_same_in_another_process(kind, file):
    error = kind("mass_kg", [-1.0], "numbers > 0", file)
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is kind
    assert str(again) == str(error)
    assert (again.field, again.given, again.allowed, again.file) == ("mass_kg", [-1.0], "numbers > 0", file)
