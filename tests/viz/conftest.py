"""Results that the tests of figures and recordings share: simulated once."""

from pathlib import Path

import pytest

from scenarios import Scenario, run_scenario
from scenarios.results.files import write_json
from testbed import Rotate, Weigh
from tests.helpers.simulated import put_trial

SMALL = {
    "objects": ["I2"],
    "support": ["own_weight"],
    "sensing": ["ft300s"],
    "seeds": 1,
    "policy": {"pivots": 3, "duration": 2.0, "accelerated": 2, "held_out": 0},
    "methods": {"hidden_states": {}, "explicit_state": {"iterations": 40}},
}


@pytest.fixture(scope="session")
def finished_run(tmp_path_factory) -> Path:
    """Folder of a small finished run."""
    root = tmp_path_factory.mktemp("run")
    run_scenario(Scenario.model_validate(SMALL), root, 0, lambda *_, **__: None, "inline")
    return root


@pytest.fixture(scope="session")
def turn_folder(tmp_path_factory) -> Path:
    """Folder with a turn of L2 and a weighing."""
    root = tmp_path_factory.mktemp("turn")
    put_trial(root, "L2", Rotate(0, duration=3.0))
    put_trial(root, "L2", Weigh())
    write_json(root / "manifest.json", {"scenario": {"sensing": ["ideal", "ft300s"]}})
    return root


@pytest.fixture(scope="session")
def turn_key(turn_folder) -> str:
    """Key of the turn."""
    return next(path.parent.name for path in turn_folder.glob("trials/*/foot_forces.parquet"))
