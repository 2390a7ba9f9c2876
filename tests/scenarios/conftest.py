"""A finished sweep that the tests of runs and of results share: made once."""

import shutil
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
import pytest

from tests.helpers.runs import resumed, small_scenario

METHODS = """
held_out = 1
[methods.hidden_states]
[methods.bare]
method = "random_search"
iterations = 20
[methods.given]
method = "random_search"
use_weight = true
iterations = 20
"""


@dataclass(frozen=True)
class Finished:
    """A run that nothing happened to."""

    scenario: Path
    rows: pd.DataFrame
    out: Path


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Finished:
    folder = tmp_path_factory.mktemp("finished")
    scenario = small_scenario(folder, ("own_weight",), METHODS)
    return Finished(scenario, resumed(scenario, folder / "out"), folder / "out")


@pytest.fixture
def copied(finished: Finished, tmp_path: Path) -> Path:
    """Copy of the finished folder, to damage."""
    return Path(shutil.copytree(finished.out, tmp_path / "out"))
