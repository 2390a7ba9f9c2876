"""Rows, errors and answers stay what they were while the code behind them changes."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.goldens.cases import CASES, SWEEPS, frozen, rows_of

HERE = Path(__file__).parent
SAME = 1e-9
"""Relative to the largest number of an array: what sums in another order leave."""
SLOW = ("lifts", "pushes", "links", "lab", "rough")


def difference(found: np.ndarray, kept: np.ndarray) -> float:
    """Largest difference of two arrays, over the largest number of the second; infinite ones are the same or not."""
    known = np.isfinite(kept)
    if not np.array_equal(np.nan_to_num(found[~known], nan=-1.0), np.nan_to_num(kept[~known], nan=-1.0)):
        return np.inf
    largest = np.abs(kept[known]).max(initial=0.0)
    return float(np.abs(found[known] - kept[known]).max(initial=0.0) / (largest or 1.0))


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] * (n in SLOW)) for n in CASES])
def test_numbers_are_those_that_were_frozen(name):
    with np.load(HERE / f"{name}.npz") as kept:
        found = frozen(CASES[name]())
        assert set(found) == set(kept.files)
        off = {key: difference(found[key], kept[key]) for key in kept.files}
    assert max(off.values()) < SAME, {key: size for key, size in off.items() if not size < SAME}


@pytest.mark.slow
@pytest.mark.parametrize("name", SWEEPS)
def test_rows_of_small_runs_are_those_that_were_frozen(name, tmp_path):
    kept, found = json.loads((HERE / f"rows_{name}.json").read_text(encoding="utf-8")), rows_of(name, tmp_path)
    assert len(kept) == len(found)
    for old, new in zip(kept, found, strict=True):
        for key, value in old.items():
            assert new[key] == (pytest.approx(value, rel=1e-6) if isinstance(value, float | list) else value), key
