"""A user's own package of a name of heft's: what hides what is said, and the user's tests run."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from testbed.packages import hidden_package

ROOT = Path(__file__).parent.parent.parent


def test_nothing_hides_heft_here():
    assert hidden_package() is None


@pytest.mark.parametrize(
    ("command", "code", "said"),
    [
        (["scenarios", "objects"], 2, "heft: {folder} hides heft's package estimators: rename it"),
        (["pytest", "-p", "testbed.pytest_plugin", "test_mine.py"], 0, "1 passed"),
        (["pytest", "-p", "testbed.pytest_plugin", "--estimator", "a:B"], 4, "--estimator: {folder} hides"),
    ],
    ids=["command", "own tests", "kit"],
)
def test_a_folder_that_hides_a_package_is_named(tmp_path: Path, command: list[str], code: int, said: str):
    folder = tmp_path / "estimators"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (tmp_path / "test_mine.py").write_text("import estimators\n\n\ndef test_mine():\n    assert estimators\n")
    environment = os.environ | {"PYTHONPATH": str(ROOT), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    done = subprocess.run(
        [sys.executable, "-m", *command], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == code, done.stderr
    assert said.format(folder=folder) in done.stdout + done.stderr
