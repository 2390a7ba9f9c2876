"""The wheel holds all that heft needs, wherever it is run from."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
SCRIPT = """
import estimators, pathlib, scenarios, sys, testbed, viz
assert pathlib.Path(testbed.__file__).is_relative_to(sys.argv[1]), testbed.__file__
from scenarios.cli.main import main
from testbed.simulation.motion import arm_model
arm_model()
main(["objects"])
main(["scenarios"])
main(["show", "F2"])
main(["show", "hammer"])
from estimators.testing.recorded import load_block
assert load_block("L2-rigid").clean
for package in (testbed, estimators, scenarios, viz):
    assert (pathlib.Path(package.__file__).parent / "py.typed").is_file(), package
"""


@pytest.mark.slow
def test_a_wheel_runs_from_another_folder(tmp_path):
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(tmp_path), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("heft_testbed-*.whl")
    target = tmp_path / "site"
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", str(target), str(wheel)]
    subprocess.run(install, check=True, capture_output=True)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(target)],
        check=False, capture_output=True, text=True, cwd=elsewhere, env=os.environ | {"PYTHONPATH": str(target)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "I2" in done.stdout
    assert "blocks" in done.stdout
